//! Trained networks as policies. This is the only file of the crate that names `train`.

use super::{ApproachFactory, ApproachPolicy, AvoidFactory, AvoidPolicy, View};
use crate::error::{Error, Result};
use crate::trial::Trial;
use train::{ApproachModel, AvoidModel};
use world::{AvoidanceMap, Environment, PoseChange};

impl ApproachFactory for ApproachModel {
    fn for_trial<'a>(&'a self, _: &'a Environment, _: &'a Trial) -> Box<dyn ApproachPolicy + 'a> {
        Box::new(self)
    }
}

impl ApproachPolicy for &ApproachModel {
    fn pose_change(&mut self, view: &View) -> Result<PoseChange> {
        let label = ApproachModel::pose_change(self, view.current, view.goal).map_err(policy_error)?;
        Ok(self.label().twist(&label, view.robot_from_hand))
    }
}

impl AvoidFactory for AvoidModel {
    fn for_trial<'a>(&'a self, _: &'a Environment, _: &'a Trial) -> Box<dyn AvoidPolicy + 'a> {
        Box::new(self)
    }
}

impl AvoidPolicy for &AvoidModel {
    fn avoidance_map(&mut self, view: &View) -> Result<AvoidanceMap> {
        AvoidModel::avoidance_map(self, view.current).map_err(policy_error)
    }
}

fn policy_error(error: train::Error) -> Error {
    Error::Policy(Box::new(error))
}
