//! Who answers in a session: the two roles that the paper gives to `CNN_approach` and `CNN_avoid` (Figure 2).
//!
//! Each role is played by a network or by an [`oracle`](crate::oracle), through the same session.

use crate::error::Result;
use image::RgbImage;
use nalgebra::Isometry3;
use world::{AvoidanceMap, PoseChange, Scene};

/// What any policy sees at one step.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// What the wrist camera sees now.
    pub current: &'a RgbImage,
    /// What it would see at the goal.
    pub goal: &'a RgbImage,
    /// Where the hand is now: a robot knows it from its joints, and needs it to read a label in the robot frame.
    pub robot_from_hand: &'a Isometry3<f64>,
}

/// What only an oracle may look at.
#[derive(Debug, Clone, Copy)]
pub struct Truth<'a> {
    /// What stands on the table.
    pub scene: &'a Scene,
    /// Where the goal image was taken.
    pub robot_from_goal: &'a Isometry3<f64>,
}

/// In the place of `CNN_approach` (paper, Section 4.1).
pub trait ApproachPolicy: Sync {
    /// The whole motion from the current pose to the goal, `v_g`, as a twist in the current hand frame.
    fn pose_change(&self, view: &View, truth: &Truth) -> Result<PoseChange>;
}

/// In the place of `CNN_avoid` (paper, Section 4.2).
pub trait AvoidPolicy: Sync {
    /// The avoidance values `G`, one for each measuring point of the world.
    fn avoidance_map(&self, view: &View, truth: &Truth) -> Result<AvoidanceMap>;
}

/// The two policies of a session.
#[derive(Clone, Copy)]
pub struct Policies<'a> {
    /// Where to go.
    pub approach: &'a dyn ApproachPolicy,
    /// Where not to go.
    pub avoid: &'a dyn AvoidPolicy,
}
