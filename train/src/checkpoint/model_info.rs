//! `model.json`: the meaning of the weights of a checkpoint, and their origin.

use std::path::Path;

use serde::{Deserialize, Serialize};
use world::config::CameraConfig;

use super::files::{MODEL, WEIGHTS, invalid, read_json, verify};
use super::lineage::{Parent, Program};
use crate::data::examples::{Examples, Source};
use crate::data::standardization::Standardization;
use crate::error::{Error, Result};
use crate::metrics::history::EpochRecord;
use crate::network::task::Task;

/// Version of the checkpoint format.
const FORMAT: u32 = 2;

/// Contents of `model.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelInfo {
    /// Version of the checkpoint format.
    pub format: u32,
    /// Task and network.
    pub task: Task,
    /// Standardization of the output of `CNN_approach`, to meters and radians.
    pub standardization: Option<Standardization>,
    /// Camera of the training images.
    pub camera: CameraConfig,
    /// Training data.
    pub datasets: Vec<Source>,
    /// Seed of the training.
    pub seed: u64,
    /// SHA-256 of the published weights that training started from, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pretrained_sha256: Option<String>,
    /// Model that training started from, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parent: Option<Parent>,
    /// Device of the training, the last one if it changed. Older checkpoints lack this field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Program of the training, the last one if it changed. Older checkpoints lack this field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<Program>,
    /// Epoch after which the weights were saved. `None` before the end of the first epoch.
    pub epoch: Option<EpochRecord>,
    /// SHA-256 of the weights.
    pub weights_sha256: String,
}

/// The field that `model.json` has in every format.
#[derive(Deserialize)]
struct Format {
    format: u32,
}

impl ModelInfo {
    /// Reads and checks the information of a checkpoint.
    pub fn read(directory: &Path) -> Result<Self> {
        let path = directory.join(MODEL);
        let Format { format } = read_json(&path)?;
        if format != FORMAT {
            let problem = format!("it has format {format}, but this program reads format {FORMAT}");
            return Err(invalid(&path, &problem));
        }
        let info: Self = read_json(&path)?;
        match info.problem() {
            None => Ok(info),
            Some(problem) => Err(invalid(&path, &problem)),
        }
    }

    /// Returns the reason why the network cannot be built, if there is one. Checkpoints may come from untrusted sources.
    fn problem(&self) -> Option<String> {
        if let Err(error) = self.task.validate() {
            return Some(Error::from(error).to_string());
        }
        let fits = self.standardization.as_ref().is_none_or(Standardization::fits::<6>);
        (!fits).then(|| "standardization: expected 6 means and 6 scales above 0".to_owned())
    }

    /// Reads the information of a checkpoint and checks the digest of its weights.
    pub(crate) fn verified(directory: &Path) -> Result<Self> {
        let info = Self::read(directory)?;
        verify(&directory.join(WEIGHTS), &info.weights_sha256)?;
        Ok(info)
    }

    /// Returns the information that follows from the task and the data. The caller adds the rest.
    pub(crate) fn new(task: &Task, examples: &Examples, standardization: Option<&Standardization>) -> Self {
        Self {
            format: FORMAT,
            task: task.clone(),
            standardization: standardization.cloned(),
            camera: examples.camera().clone(),
            datasets: examples.sources().to_vec(),
            seed: 0,
            pretrained_sha256: None,
            parent: None,
            device: None,
            program: None,
            epoch: None,
            weights_sha256: String::new(),
        }
    }
}
