//! The trained networks in the roles of a session: the only file of this crate that names `train`.

use crate::error::{Error, Result};
use crate::policy::{ApproachPolicy, AvoidPolicy, Truth, View};
use train::{ApproachModel, AvoidModel};
use world::{AvoidanceMap, PoseChange};

impl ApproachPolicy for ApproachModel {
    fn pose_change(&self, view: &View, _: &Truth) -> Result<PoseChange> {
        let label = ApproachModel::pose_change(self, view.current, view.goal).map_err(unanswered)?;
        Ok(self.label().twist(&label, view.robot_from_hand))
    }
}

impl AvoidPolicy for AvoidModel {
    fn avoidance_map(&self, view: &View, _: &Truth) -> Result<AvoidanceMap> {
        AvoidModel::avoidance_map(self, view.current).map_err(unanswered)
    }
}

fn unanswered(error: train::Error) -> Error {
    Error::Policy(Box::new(error))
}
