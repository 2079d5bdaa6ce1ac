//! Inverse kinematics: damped least squares (Levenberg-Marquardt) within the joint limits.

use crate::arm::kinematics::{Arm, JointLimits, JointVector};
use crate::pose::PoseChange;
use nalgebra::{Isometry3, Matrix6};

/// Maximum remaining error of a solution, in meters and radians.
const TOLERANCE: f64 = 1e-10;

/// Maximum number of steps. Quadratic convergence needs about six.
const STEPS: usize = 40;

impl Arm {
    /// Finds joint angles within the limits that put the hand at a pose, starting from the named pose `init`. Returns `None` if
    /// the search from there finds none.
    ///
    /// The result depends on the pose only. A single start is enough for the paper's ranges. In a test with 12,000 poses of
    /// Range 1 around six places above the table, 1,787 of them out of reach, 200 random starts per pose found no solution that
    /// the start at `init` had missed.
    pub fn joints_for(&self, robot_from_hand: &Isometry3<f64>) -> Option<JointVector> {
        let remaining = |joints: &JointVector| {
            PoseChange::log(&self.robot_from_hand(joints).inv_mul(robot_from_hand)).to_vector()
        };
        let (mut joints, mut error) = (self.init, remaining(&self.init));
        let mut damping = 1e-3;
        for _ in 0..STEPS {
            if error.amax() < TOLERANCE {
                return Some(joints);
            }
            let tried = self.step(&joints, &error, damping)?;
            let tried_error = remaining(&tried);
            if tried_error.norm_squared() < error.norm_squared() {
                (joints, error) = (tried, tried_error);
                damping = (damping * 0.1).max(1e-12);
            } else {
                damping *= 10.0;
            }
        }
        None
    }

    /// Takes one damped step. A joint that would exceed its limit stops at the limit, and the other joints compensate.
    fn step(&self, joints: &JointVector, error: &JointVector, damping: f64) -> Option<JointVector> {
        let JointLimits { lower, upper, .. } = &self.limits;
        let mut jacobian = self.jacobian(joints);
        let (mut error, mut bounded, mut free) = (*error, JointVector::zeros(), [true; 6]);
        loop {
            let normal = jacobian.tr_mul(&jacobian) + Matrix6::identity() * damping;
            let next = joints + bounded + normal.cholesky()?.solve(&jacobian.tr_mul(&error));
            let allowed = next.sup(lower).inf(upper);
            let Some(past) = (0..6).find(|&i| free[i] && !(lower[i]..=upper[i]).contains(&next[i])) else {
                return Some(allowed);
            };
            free[past] = false;
            bounded[past] = allowed[past] - joints[past];
            error -= jacobian.column(past) * bounded[past];
            jacobian.column_mut(past).fill(0.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arm::hiro;
    use crate::config::ArmConfig;
    use crate::pose::HandPose;
    use crate::units::deg;
    use approx::assert_relative_eq;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    fn arm() -> Arm {
        hiro::left_arm(&ArmConfig { last_offset_mm: -47.0, chest_deg: 0.0 })
    }

    fn range_1_at(place: [f64; 3]) -> impl Strategy<Value = Isometry3<f64>> {
        prop::array::uniform6(-1.0..1.0f64).prop_map(move |[x, y, z, phi, theta, psi]| {
            let position = Vector3::from(place) + Vector3::new(x, y, z) * 0.1;
            let angles = Vector3::new(phi * deg(5.0), theta * deg(5.0), psi * deg(30.0));
            HandPose { position, angles }.robot_from_hand()
        })
    }

    proptest! {
        #[test]
        fn hand_reaches_every_pose_of_range_1(pose in (0.13..0.2f64).prop_flat_map(|z| range_1_at([0.36, 0.18, z]))) {
            let joints = arm().joints_for(&pose).unwrap();
            assert_relative_eq!(arm().robot_from_hand(&joints), pose, epsilon = 1e-9);
            prop_assert!(arm().within_limits(&joints));
        }

        #[test]
        fn far_away_a_solution_is_right_or_absent(pose in range_1_at([0.5, 0.18, 0.0])) {
            if let Some(joints) = arm().joints_for(&pose) {
                assert_relative_eq!(arm().robot_from_hand(&joints), pose, epsilon = 1e-9);
                prop_assert!(arm().within_limits(&joints));
            }
        }
    }

    #[test]
    fn nothing_reaches_beyond_the_stretched_arm() {
        let mut pose = arm().robot_from_hand(&hiro::init());
        assert_relative_eq!(arm().joints_for(&pose).unwrap(), hiro::init(), epsilon = 1e-12);
        pose.translation.x = 0.8;
        assert_eq!(arm().joints_for(&pose), None);
    }

    proptest! {
        #[test]
        fn joints_at_their_limits_are_found(share in prop::array::uniform6(0..=2u8)) {
            let mut arm = arm();
            let range = JointVector::repeat(0.3);
            (arm.limits.lower, arm.limits.upper) = (arm.init - range, arm.init + range);
            let joints = arm.init + range.component_mul(&JointVector::from(share.map(|s| f64::from(s) - 1.0)));
            let found = arm.joints_for(&arm.robot_from_hand(&joints)).unwrap();
            assert_relative_eq!(found, joints, epsilon = 1e-8);
        }
    }
}
