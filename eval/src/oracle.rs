//! Both policies from ground truth. What a session with oracles does wrong, the loop does wrong, not the networks.

use crate::error::Result;
use crate::policy::{ApproachPolicy, AvoidPolicy, Truth, View};
use world::environment::Environment;
use world::{AvoidanceMap, LabelForm, PoseChange};

/// A perfect `CNN_approach`: the label itself.
#[derive(Debug, Clone, Copy)]
pub struct ApproachOracle;

impl ApproachPolicy for ApproachOracle {
    fn pose_change(&self, view: &View, truth: &Truth) -> Result<PoseChange> {
        Ok(LabelForm::Twist.label(view.robot_from_hand, truth.robot_from_goal))
    }
}

/// A perfect `CNN_avoid`: the label itself.
#[derive(Debug, Clone, Copy)]
pub struct AvoidOracle<'a> {
    /// Where the label comes from.
    pub environment: &'a Environment,
}

impl AvoidPolicy for AvoidOracle<'_> {
    fn avoidance_map(&self, view: &View, truth: &Truth) -> Result<AvoidanceMap> {
        Ok(self.environment.avoidance_map(truth.scene, view.robot_from_hand))
    }
}
