//! A serial arm of six revolute joints: limits, forward kinematics and the Jacobian.

use nalgebra::{Isometry3, Matrix6, UnitQuaternion, UnitVector3, Vector6};

/// Joint angles \[rad\], or another quantity with one number per joint.
pub type JointVector = Vector6<f64>;

/// Limits of the joints.
#[derive(Debug, Clone, PartialEq)]
pub struct JointLimits {
    /// Lower limits of the angles \[rad\].
    pub lower: JointVector,
    /// Upper limits of the angles \[rad\].
    pub upper: JointVector,
    /// Maximum speeds \[rad/s\].
    pub max_velocity: JointVector,
}

/// A revolute joint.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Joint {
    /// Pose of the joint at angle 0, in the frame of the joint before it (for the first joint, in the robot frame).
    pub(crate) parent_from_joint: Isometry3<f64>,
    /// Axis in the frame of the joint.
    pub(crate) axis: UnitVector3<f64>,
}

/// A serial arm with a hand at its end.
#[derive(Debug, Clone, PartialEq)]
pub struct Arm {
    pub(crate) joints: [Joint; 6],
    pub(crate) last_link_from_hand: Isometry3<f64>,
    pub(crate) limits: JointLimits,
    pub(crate) init: JointVector,
}

impl Arm {
    /// Returns the poses of the six links.
    pub(super) fn robot_from_links(&self, joints: &JointVector) -> [Isometry3<f64>; 6] {
        let mut robot_from_link = Isometry3::identity();
        std::array::from_fn(|i| {
            let Joint { parent_from_joint, axis } = &self.joints[i];
            robot_from_link *= parent_from_joint * UnitQuaternion::from_axis_angle(axis, joints[i]);
            robot_from_link
        })
    }

    /// Returns the pose of the hand: forward kinematics.
    pub fn robot_from_hand(&self, joints: &JointVector) -> Isometry3<f64> {
        self.robot_from_links(joints)[5] * self.last_link_from_hand
    }

    /// Returns the geometric Jacobian `J` of Eq. (6): the twist of the hand in the hand frame (translation first) per joint rate.
    pub fn jacobian(&self, joints: &JointVector) -> Matrix6<f64> {
        let links = self.robot_from_links(joints);
        let robot_from_hand = links[5] * self.last_link_from_hand;
        let hand_from_robot = robot_from_hand.rotation.inverse();
        let mut jacobian = Matrix6::zeros();
        for (i, robot_from_link) in links.iter().enumerate() {
            let axis = robot_from_link.rotation * self.joints[i].axis.into_inner();
            let lever = robot_from_hand.translation.vector - robot_from_link.translation.vector;
            jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(&(hand_from_robot * axis.cross(&lever)));
            jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(&(hand_from_robot * axis));
        }
        jacobian
    }

    /// Returns the limits of the joints.
    pub fn limits(&self) -> &JointLimits {
        &self.limits
    }

    /// Returns whether all angles are within their limits, with a tolerance of 1e-9 rad for rounding.
    pub fn within_limits(&self, joints: &JointVector) -> bool {
        let JointLimits { lower, upper, .. } = &self.limits;
        (0..6).all(|i| (lower[i] - 1e-9..=upper[i] + 1e-9).contains(&joints[i]))
    }
}
