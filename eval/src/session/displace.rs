//! Joint displacement of one step, with contact detection along the way.

use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use world::arm::JointVector;
use world::{Contacts, Environment, PoseChange, Scene};

/// Largest distance between two poses that are checked for contacts, at the fingertips \[m\].
const CONTACT_SPACING: f64 = 2e-3;

/// Distance of the fingertips from the hand frame, with a margin \[m\].
const HAND_SIZE: f64 = 0.1;

/// Contacts of the hand during a step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Touched {
    /// Contact with an obstacle.
    pub obstacle: bool,
    /// Contact with the target. It does not end the session: the paper does not avoid the target.
    pub target: bool,
    /// Contact with the table.
    pub table: bool,
}

impl Touched {
    /// Adds the contacts at one pose.
    fn add(&mut self, contacts: Contacts) {
        self.obstacle |= contacts.obstacle;
        self.target |= contacts.target;
        self.table |= contacts.table;
    }

    /// Returns whether the hand hit something that it must avoid.
    pub fn is_collision(self) -> bool {
        self.obstacle || self.table
    }
}

/// Moves the joints by a displacement, or up to the first contact with an obstacle or the table.
pub(super) fn displace(
    environment: &Environment,
    scene: &Scene,
    joints: &mut JointVector,
    displacement: &JointVector,
) -> Touched {
    let Environment { arm, hand, .. } = environment;
    let start = *joints;
    let count = pose_count(&arm.robot_from_hand(&start), &arm.robot_from_hand(&(start + displacement)));
    let mut touched = Touched::default();
    for k in 1..=count as usize {
        *joints = start + displacement * (k as f64 / count);
        touched.add(hand.contacts(&arm.robot_from_hand(joints), scene));
        if touched.is_collision() {
            break;
        }
    }
    touched
}

/// Returns how many poses to check between two hand poses, a whole number of at least 1.
fn pose_count(from: &Isometry3<f64>, to: &Isometry3<f64>) -> f64 {
    let motion = PoseChange::log(&from.inv_mul(to));
    let length = motion.translation.norm() + motion.rotation.norm() * HAND_SIZE;
    (length / CONTACT_SPACING).ceil().max(1.0)
}
