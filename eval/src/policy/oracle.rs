//! Ground truth in both roles. An error of a session with oracles is due to the loop, not to a network.

use super::{ApproachFactory, ApproachPolicy, AvoidFactory, AvoidPolicy, View};
use crate::error::Result;
use crate::trial::Trial;
use world::{AvoidanceMap, Environment, LabelForm, PoseChange};

/// Makes oracles for both roles.
#[derive(Debug, Clone, Copy)]
pub struct Oracle;

/// A perfect `CNN_approach`: returns the label.
struct ApproachOracle<'a> {
    trial: &'a Trial,
}

/// A perfect `CNN_avoid`: returns the label.
struct AvoidOracle<'a> {
    environment: &'a Environment,
    trial: &'a Trial,
}

impl ApproachFactory for Oracle {
    fn for_trial<'a>(&'a self, _: &'a Environment, trial: &'a Trial) -> Box<dyn ApproachPolicy + 'a> {
        Box::new(ApproachOracle { trial })
    }
}

impl ApproachPolicy for ApproachOracle<'_> {
    fn pose_change(&mut self, view: &View) -> Result<PoseChange> {
        Ok(LabelForm::Twist.label(view.robot_from_hand, &self.trial.robot_from_goal))
    }
}

impl AvoidFactory for Oracle {
    fn for_trial<'a>(&'a self, environment: &'a Environment, trial: &'a Trial) -> Box<dyn AvoidPolicy + 'a> {
        Box::new(AvoidOracle { environment, trial })
    }
}

impl AvoidPolicy for AvoidOracle<'_> {
    fn avoidance_map(&mut self, view: &View) -> Result<AvoidanceMap> {
        Ok(self.environment.avoidance_map(&self.trial.scene, view.robot_from_hand))
    }
}
