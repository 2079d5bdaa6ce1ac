//! HIRO's left arm (Kawada Industries; paper, Section 6.1): the published numbers.
//!
//! Sources: `start-jsk/rtmros_hironx` at f2de65e (`HiroNX.urdf`, `kawada-hironx.dae` and `.yaml`, `hironx_client.py`) and
//! `tork-a/rtmros_nextage` at e605274 (`NextageOpen.urdf`). Only numbers are used, no meshes.
//!
//! The sources disagree on three points:
//! * Offset of the last joint along x: -0.047 m in the `.dae` ("to match CAD data") and the Nextage, -0.040 m in the older URDF.
//!   `ArmConfig` selects one.
//! * Range of `LARM_JOINT3`: HIRO's files repeat the right arm's -165° … 105°; the Nextage's mirror it to -105° … 165°. The arms
//!   mirror each other in everything else, so the mirrored range is used. A hand that looks down reaches the same poses with
//!   either.
//! * Speeds: those of the hardware model (`.dae`) are used, not the 0.5 and 1.0 rad/s that ROS software imposes.

use crate::arm::kinematics::{Arm, Joint, JointLimits, JointVector};
use crate::config::ArmConfig;
use crate::units::{deg, mm};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, UnitVector3, Vector3};
use std::f64::consts::{FRAC_PI_2, PI};

/// A row of the published table: a joint in the frame of the one before it. At angle 0 all frames are parallel.
struct Row {
    origin: [f64; 3],
    axis: UnitVector3<f64>,
    /// In degrees.
    range: [f64; 2],
    /// In degrees per second.
    max_velocity: f64,
}

/// Returns `LARM_JOINT0` … `LARM_JOINT5`. The origin of the first is in the chest frame; its axes lean by [`SHOULDER_LEAN`].
fn table(last_offset: f64) -> [Row; 6] {
    let (x, y, z) = (Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis());
    [
        Row { origin: [0.0, 0.145, 0.370_296], axis: z, range: [-88.0, 88.0], max_velocity: 172.0 },
        Row { origin: [0.0, 0.0, 0.0], axis: y, range: [-140.0, 60.0], max_velocity: 133.0 },
        Row { origin: [0.0, 0.095, -0.25], axis: y, range: [-158.0, 0.0], max_velocity: 229.0 },
        Row { origin: [-0.03, 0.0, 0.0], axis: z, range: [-105.0, 165.0], max_velocity: 150.0 },
        Row { origin: [0.0, 0.0, -0.235], axis: y, range: [-100.0, 100.0], max_velocity: 250.0 },
        Row { origin: [last_offset, 0.0, -0.09], axis: x, range: [-163.0, 163.0], max_velocity: 300.0 },
    ]
}

/// Roll of the shoulder relative to the chest, in degrees.
const SHOULDER_LEAN: f64 = -15.0;

/// Palm center ("end coordinates") in the frame of `LARM_JOINT5`.
const END_COORDINATES: [f64; 3] = [-0.05, 0.0, 0.0];

/// Returns the robot's named pose `init`, in which the hand looks straight down in front of the chest.
pub fn init() -> JointVector {
    JointVector::new(0.6, 0.0, -100.0, -15.2, 9.4, -3.2).map(deg)
}

/// Creates the left arm, with the chest joint fixed.
pub fn left_arm(config: &ArmConfig) -> Arm {
    let rows = table(mm(config.last_offset_mm));
    let chest = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), deg(config.chest_deg));
    let lean = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), deg(SHOULDER_LEAN));
    let mut joints = rows.each_ref().map(|row| Joint {
        parent_from_joint: Translation3::from(row.origin) * UnitQuaternion::identity(),
        axis: row.axis,
    });
    joints[0].parent_from_joint = chest * joints[0].parent_from_joint * lean;
    let column = |number: fn(&Row) -> f64| JointVector::from_iterator(rows.iter().map(number)).map(deg);
    Arm {
        joints,
        last_link_from_hand: last_link_from_hand(),
        limits: JointLimits {
            lower: column(|row| row.range[0]),
            upper: column(|row| row.range[1]),
            max_velocity: column(|row| row.max_velocity),
        },
        init: init(),
    }
}

/// Returns the published end coordinates (turned by 90° about y) after a half turn about their x axis. This makes z the approach
/// direction (-x of the last link), and x points forward when the hand looks down.
fn last_link_from_hand() -> Isometry3<f64> {
    let published = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2);
    let approach = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), PI);
    Isometry3::from_parts(END_COORDINATES.into(), published * approach)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::{HandPose, PoseChange, adjoint};
    use approx::assert_relative_eq;
    use nalgebra::{Matrix3, Matrix6, Point3};
    use proptest::prelude::*;

    fn arm(last_offset_mm: f64) -> Arm {
        left_arm(&ArmConfig { last_offset_mm, chest_deg: 0.0 })
    }

    fn angles(degrees: [f64; 6]) -> JointVector {
        JointVector::from(degrees).map(deg)
    }

    fn robot_from_last_link(arm: &Arm, joints: &JointVector) -> Isometry3<f64> {
        arm.robot_from_hand(joints) * arm.last_link_from_hand.inverse()
    }

    #[test]
    fn last_link_is_where_the_published_chain_puts_it() {
        let golden = [
            (init(), [0.325_563, 0.182_364, 0.074_625], [0.325_575, 0.182_363, 0.067_625]),
            (
                angles([0.0, 0.0, -130.0, 0.0, 0.0, 0.0]),
                [0.293_960, 0.212_248, 0.254_218],
                [0.298_459, 0.210_861, 0.249_039],
            ),
            (JointVector::zeros(), [-0.070, 0.087_942, -0.209_699], [-0.077, 0.087_942, -0.209_699]),
            (
                angles([0.0, -40.0, -90.0, 0.0, 0.0, 0.0]),
                [0.454_656, 0.227_386, 0.310_714],
                [0.459_156, 0.225_999, 0.305_535],
            ),
        ];
        for (joints, older, current) in golden {
            for (offset, expected) in [(-40.0, older), (-47.0, current)] {
                let found = robot_from_last_link(&arm(offset), &joints).translation.vector;
                assert_relative_eq!(found, expected.into(), epsilon = 1e-6);
            }
        }
        // The digits that the maintainers give for init; their shoulder leans by -0.261799 rad.
        let found = robot_from_last_link(&arm(-47.0), &init()).translation.vector;
        assert_relative_eq!(found, Vector3::new(0.325_575_12, 0.182_363_14, 0.067_624_52), epsilon = 2e-7);
    }

    #[test]
    fn at_init_the_last_link_points_up_and_the_hand_looks_down() {
        let arm = arm(-47.0);
        let golden =
            Matrix3::new(-0.001_77, 0.000_19, -1.0, 0.000_12, 1.0, 0.000_19, 1.0, -0.000_12, -0.001_77);
        let rotation = robot_from_last_link(&arm, &init()).rotation.to_rotation_matrix();
        assert_relative_eq!(*rotation.matrix(), golden, epsilon = 1e-5);

        let robot_from_hand = arm.robot_from_hand(&init());
        let angles = HandPose::from_transform(&robot_from_hand).angles;
        assert!(angles.amax() < deg(0.3), "{angles}");
        // The palm is 50 mm below the last link.
        let palm = robot_from_hand * Point3::origin();
        assert_relative_eq!(palm, Point3::new(0.325_66, 0.182_36, 0.017_62), epsilon = 2e-5);
    }

    #[test]
    fn jacobian_at_init_is_the_published_one() {
        let arm = arm(-40.0);
        #[rustfmt::skip]
        let golden = Matrix6::new(
            -0.12555, -0.32421, -0.07422,  0.00576, -0.08970,  0.0,
             0.31455, -0.08790, -0.08537, -0.10333, -0.00502,  0.0,
            -0.08428, -0.31493, -0.31561,  0.00002, -0.09016,  0.0,
             0.0,     -0.01047, -0.01047, -0.98475, -0.05563, -0.00177,
             0.25882,  0.96587,  0.96587, -0.05490,  0.99845,  0.00012,
             0.96593, -0.25880, -0.25880, -0.16506, -0.00022,  1.0,
        );
        let robot_from_hand = arm.robot_from_hand(&init());
        let turn = Isometry3::from_parts(Translation3::identity(), robot_from_hand.rotation);
        assert_relative_eq!(adjoint(&turn) * arm.jacobian(&init()), golden, epsilon = 2e-5);
    }

    proptest! {
        #[test]
        fn jacobian_is_the_derivative_of_forward_kinematics(share in prop::array::uniform6(0.0..1.0f64)) {
            let arm = arm(-47.0);
            let limits = arm.limits();
            let joints = limits.lower + JointVector::from(share).component_mul(&(limits.upper - limits.lower));
            let jacobian = arm.jacobian(&joints);
            for i in 0..6 {
                let step = JointVector::ith(i, 1e-5);
                let (before, after) = (arm.robot_from_hand(&(joints - step)), arm.robot_from_hand(&(joints + step)));
                let twist = PoseChange::log(&before.inv_mul(&after)).to_vector() / 2e-5;
                assert_relative_eq!(jacobian.column(i).into_owned(), twist, epsilon = 1e-8);
            }
        }
    }

    #[test]
    fn limits_are_the_published_radians() {
        let arm = arm(-47.0);
        let JointLimits { lower, upper, max_velocity } = arm.limits().clone();
        let published = |v: [f64; 6]| JointVector::from(v);
        let lowest = published([-1.53589, -2.44346, -2.75762, -1.8326, -1.74533, -2.84489]);
        let highest = published([1.53589, deg(60.0), 0.0, 2.87979, 1.74533, 2.84489]);
        let fastest = published([3.00197, 2.32129, 3.9968, 2.61799, 4.36332, 5.23599]);
        assert_relative_eq!(lower, lowest, epsilon = 1e-5);
        assert_relative_eq!(upper, highest, epsilon = 1e-5);
        assert_relative_eq!(max_velocity, fastest, epsilon = 1e-5);

        let named = [
            angles([0.0, 0.0, -130.0, 0.0, 0.0, 0.0]),
            angles([-25.0, -139.0, -157.0, -45.0, 0.0, 0.0]),
            angles([0.0, -40.0, -90.0, 0.0, 0.0, 0.0]),
            init(),
        ];
        assert!(named.iter().all(|pose| arm.within_limits(pose)));
        assert!(!arm.within_limits(&angles([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])));
        assert!(!arm.within_limits(&(lower - JointVector::ith(3, 1e-3))));
    }

    #[test]
    fn the_chest_turns_the_whole_arm() {
        let turned = left_arm(&ArmConfig { last_offset_mm: -47.0, chest_deg: 30.0 }).robot_from_hand(&init());
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), deg(30.0));
        assert_relative_eq!(turned, turn * arm(-47.0).robot_from_hand(&init()), epsilon = 1e-12);
    }

    #[test]
    fn drawn_arm_reaches_from_shoulder_to_palm() {
        let arm = arm(-47.0);
        let bodies = arm.bodies(&init(), [0.8; 3]);
        assert_relative_eq!(
            bodies[0].robot_from_body.translation.vector,
            Vector3::new(0.0, 0.145, 0.370_296)
        );
        let last = bodies.last().unwrap();
        let tip = last.robot_from_body * Point3::new(0.0, 0.0, last.shape.half_extents().z);
        assert_relative_eq!(tip, arm.robot_from_hand(&init()) * Point3::origin(), epsilon = 1e-12);
    }
}
