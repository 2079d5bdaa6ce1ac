//! The arm and the hand at its end.

mod hand;
pub mod hiro;
mod inverse_kinematics;
mod kinematics;
mod solids;

pub use hand::{Contacts, Hand};
pub use kinematics::{Arm, JointLimits, JointVector};
