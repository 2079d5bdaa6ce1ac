//! Results of an experiment.

use super::config::ExperimentConfig;
use crate::commands::dataset::Generated;
use crate::commands::train::Trained;
use eval::SessionRecord;
use eval::results::metrics;
use eval::results::system::System;
use report::page::Stage;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Results of all stages.
pub(crate) struct ExperimentResults {
    /// Configuration.
    pub(crate) config: ExperimentConfig,
    /// Name of the device.
    pub(crate) device: String,
    /// Stages in order.
    pub(crate) stages: Vec<Stage>,
    /// Datasets in the order of their names.
    pub(crate) datasets: Vec<Generated>,
    /// Networks by name: the folder and the result of each run.
    pub(crate) trained: BTreeMap<String, (PathBuf, Trained)>,
    /// Systems in order, with their sessions.
    pub(crate) systems: Vec<(System, Vec<SessionRecord>)>,
}

impl ExperimentResults {
    /// Returns the results as JSON. `seconds` is the duration of the command.
    pub(crate) fn to_json(&self, seconds: f64) -> Value {
        let trained: BTreeMap<_, _> =
            self.trained.iter().map(|(name, (_, trained))| (name, trained)).collect();
        let systems: Vec<_> = self.systems.iter().map(|(system, _)| metrics::to_json(system)).collect();
        json!({
            "seconds": seconds,
            "device": self.device,
            "datasets": self.datasets,
            "training": trained,
            "evaluation": systems,
        })
    }
}
