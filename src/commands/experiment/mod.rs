//! The paper's whole experiment, from datasets to servo sessions, as stages.

mod config;
mod results;
mod stages;

pub(super) use config::{ExperimentConfig, SystemConfig};
pub(super) use results::Reproduced;
pub(super) use stages::Stages;
