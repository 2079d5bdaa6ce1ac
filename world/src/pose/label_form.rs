//! The label of `CNN_approach`.

use crate::pose::hand_pose::HandPose;
use crate::pose::pose_change::PoseChange;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

/// Meaning of the six numbers of a label.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LabelForm {
    /// `log(T_current⁻¹ T_goal)` in se(3), in the current hand frame. It is determined by the two images alone, and swapping
    /// them negates it.
    Twist,
    /// The paper's `Δx` (Section 4.1): goal minus current pose, as the numbers of a [`HandPose`] in the robot frame.
    Difference,
}

impl LabelForm {
    /// Returns the label of a pair of hand poses.
    pub fn label(self, robot_from_current: &Isometry3<f64>, robot_from_goal: &Isometry3<f64>) -> PoseChange {
        match self {
            Self::Twist => PoseChange::log(&robot_from_current.inv_mul(robot_from_goal)),
            Self::Difference => {
                let current = HandPose::from_transform(robot_from_current);
                let goal = HandPose::from_transform(robot_from_goal);
                PoseChange {
                    translation: goal.position - current.position,
                    rotation: (goal.angles - current.angles).map(wrapped),
                }
            }
        }
    }

    /// Returns the twist, in the current hand frame, from the current pose to the goal that a label encodes.
    pub fn twist(self, label: &PoseChange, robot_from_current: &Isometry3<f64>) -> PoseChange {
        match self {
            Self::Twist => *label,
            Self::Difference => {
                let current = HandPose::from_transform(robot_from_current);
                let goal = HandPose {
                    position: current.position + label.translation,
                    angles: current.angles + label.rotation,
                };
                PoseChange::log(&robot_from_current.inv_mul(&goal.robot_from_hand()))
            }
        }
    }
}

/// Wraps an angle to `[-π, π]`.
fn wrapped(angle: f64) -> f64 {
    angle - (angle / std::f64::consts::TAU).round() * std::f64::consts::TAU
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::poses;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_label_leads_from_current_to_goal(current in poses(), goal in poses()) {
            let (current, goal) = (current.robot_from_hand(), goal.robot_from_hand());
            for form in [LabelForm::Twist, LabelForm::Difference] {
                let twist = form.twist(&form.label(&current, &goal), &current);
                assert_relative_eq!(current * twist.exp(), goal, epsilon = 1e-9);
            }
        }

        #[test]
        fn swapping_the_poses_negates_the_twist(current in poses(), goal in poses()) {
            let (current, goal) = (current.robot_from_hand(), goal.robot_from_hand());
            let there = LabelForm::Twist.label(&current, &goal);
            let back = LabelForm::Twist.label(&goal, &current);
            assert_relative_eq!(there.to_vector(), -back.to_vector(), epsilon = 1e-9);
        }
    }
}
