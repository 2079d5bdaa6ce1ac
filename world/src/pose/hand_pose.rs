//! A hand pose as six numbers.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A hand pose as the paper's six numbers: the position in the robot frame, and the angles `φ θ ψ` about the robot's x, y and
/// z axes, applied in this order to a hand that looks straight down.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HandPose {
    /// Palm center in the robot frame \[m\].
    pub position: Vector3<f64>,
    /// `φ θ ψ` \[rad\].
    pub angles: Vector3<f64>,
}

/// Returns the orientation of a hand that looks straight down: x forward, y right, z down.
fn robot_from_hand_looking_down() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
}

impl HandPose {
    /// Returns the pose as a transform.
    pub fn robot_from_hand(&self) -> Isometry3<f64> {
        let turned = UnitQuaternion::from_euler_angles(self.angles.x, self.angles.y, self.angles.z);
        Isometry3::from_parts(Translation3::from(self.position), turned * robot_from_hand_looking_down())
    }

    /// Returns the six numbers of a transform, with `θ` in `[-π/2, π/2]`.
    pub fn from_transform(robot_from_hand: &Isometry3<f64>) -> Self {
        let turned = robot_from_hand.rotation * robot_from_hand_looking_down().inverse();
        let (phi, theta, psi) = turned.euler_angles();
        Self { position: robot_from_hand.translation.vector, angles: Vector3::new(phi, theta, psi) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::poses;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn six_numbers_and_transform_describe_the_same_pose(pose in poses()) {
            let again = HandPose::from_transform(&pose.robot_from_hand());
            assert_relative_eq!(again.position, pose.position, epsilon = 1e-12);
            assert_relative_eq!(again.angles, pose.angles, epsilon = 1e-9);
        }
    }

    #[test]
    fn a_hand_with_zero_angles_looks_down_with_x_forward() {
        let pose = HandPose { position: Vector3::zeros(), angles: Vector3::zeros() }.robot_from_hand();
        assert_relative_eq!(pose * Vector3::x(), Vector3::x(), epsilon = 1e-15);
        assert_relative_eq!(pose * Vector3::y(), -Vector3::y(), epsilon = 1e-15);
        assert_relative_eq!(pose * Vector3::z(), -Vector3::z(), epsilon = 1e-15);
    }
}
