//! The two policies of a servo session, in the roles of `CNN_approach` and `CNN_avoid` (paper, Figure 2).
//!
//! A factory makes a new policy for each trial, so that a policy may keep state from step to step. Networks see only the
//! [`View`]. A policy that needs ground truth, such as those of the [`oracle`], takes it from the trial when it is made.

pub mod network;
pub mod oracle;

use crate::error::Result;
use crate::trial::Trial;
use image::RgbImage;
use nalgebra::Isometry3;
use world::arm::JointVector;
use world::{AvoidanceMap, Camera, Environment, PoseChange};

/// The input of a policy at one step.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// Current image of the wrist camera.
    pub current: &'a RgbImage,
    /// Image of the wrist camera at the goal pose.
    pub goal: &'a RgbImage,
    /// Current joint angles \[rad\].
    pub joints: &'a JointVector,
    /// Current hand pose, which follows from the joint angles.
    pub robot_from_hand: &'a Isometry3<f64>,
    /// Intrinsics of the wrist camera and its mounting on the hand.
    pub camera: &'a Camera,
}

/// The approach policy of one trial, in the role of `CNN_approach` (paper, Section 4.1).
pub trait ApproachPolicy {
    /// Returns the motion from the current pose to the goal, `v_g`, as a twist in the current hand frame.
    fn pose_change(&mut self, view: &View) -> Result<PoseChange>;
}

/// The avoid policy of one trial, in the role of `CNN_avoid` (paper, Section 4.2).
pub trait AvoidPolicy {
    /// Returns the avoidance values `G`, one per measuring point of the world.
    fn avoidance_map(&mut self, view: &View) -> Result<AvoidanceMap>;
}

/// Makes approach policies. Sessions run in parallel and share the factory.
pub trait ApproachFactory: Sync {
    /// Returns the policy of a trial.
    fn for_trial<'a>(
        &'a self,
        environment: &'a Environment,
        trial: &'a Trial,
    ) -> Box<dyn ApproachPolicy + 'a>;
}

/// Makes avoid policies. Sessions run in parallel and share the factory.
pub trait AvoidFactory: Sync {
    /// Returns the policy of a trial.
    fn for_trial<'a>(&'a self, environment: &'a Environment, trial: &'a Trial) -> Box<dyn AvoidPolicy + 'a>;
}

/// The policies of an evaluation.
#[derive(Clone, Copy)]
pub struct Policies<'a> {
    /// Makes the approach policy of each trial.
    pub approach: &'a dyn ApproachFactory,
    /// Makes the avoid policy of each trial.
    pub avoid: &'a dyn AvoidFactory,
}
