//! Checkpoints: all that is needed to use a network, in one directory that is published by rename.
//!
//! ```text
//! model.json            what it is: architecture, meaning of the output, camera, data, metrics, digest of the weights
//! weights.safetensors   the weights, under readable names
//! config.json           the same for other programs: layers, input, output
//! config.toml           the training configuration
//! training.json         only in `last`: where training stands
//! optimizer.safetensors only in `last`: the optimizer's moments
//! ```

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use burn_store::{ModuleSnapshot, SafetensorsStore};
use datagen::digest::digest_of_file;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use world::config::CameraConfig;

use crate::adamw::AdamW;
use crate::config::{Task, TrainConfig};
use crate::description::Description;
use crate::error::{Error, Result};
use crate::examples::{Examples, Source};
use crate::history::EpochRecord;
use crate::network::Network;
use crate::normalization::Standardization;
use crate::place::Place;
use crate::publish::{self, at};
use crate::warm_start::Parent;

/// Version of the directory's form.
const FORMAT: u32 = 2;
/// Name of the file that says what a checkpoint is.
pub const MODEL: &str = "model.json";
/// Name of the file with the weights.
pub const WEIGHTS: &str = "weights.safetensors";
const CONFIG: &str = "config.toml";
const TRAINING: &str = "training.json";
const OPTIMIZER: &str = "optimizer.safetensors";

/// What `model.json` says: what the weights are, and how to use them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelInfo {
    /// Version of the directory's form.
    pub format: u32,
    /// What was learned, by which network.
    pub task: Task,
    /// What brings the output of `CNN_approach` into metres and radians.
    pub standardization: Option<Standardization>,
    /// The camera whose images it was trained on.
    pub camera: CameraConfig,
    /// The data it was trained on.
    pub datasets: Vec<Source>,
    /// Seed of the training.
    pub seed: u64,
    /// SHA-256 of the file of published weights that the training began from, if it did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pretrained_sha256: Option<String>,
    /// The model that the training began from, if it did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parent: Option<Parent>,
    /// Where the weights were computed; of a run that changed its device, the last one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// What computed them, if it is known; of a run that changed its program, the last one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<Program>,
    /// State of the training when the weights were saved; none before the end of the first epoch.
    pub epoch: Option<EpochRecord>,
    /// SHA-256 of the weights' file.
    pub weights_sha256: String,
}

/// The program that trains.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Program {
    /// Revision of its code, if it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub code_revision: Option<String>,
    /// Itself and what it is made with: name and version.
    pub software: BTreeMap<String, String>,
}

/// What every version of `model.json` says.
#[derive(Deserialize)]
struct Form {
    format: u32,
}

/// A network that was read from a directory.
#[derive(Debug)]
pub struct Checkpoint {
    /// Where it was read from.
    pub directory: PathBuf,
    /// What it is.
    pub info: ModelInfo,
    /// The network with its weights.
    pub network: Network,
}

impl Checkpoint {
    /// Reads a checkpoint. Names the file that is missing, damaged, or of another form or architecture.
    pub fn load(directory: &Path, device: &Device) -> Result<Self> {
        let info = ModelInfo::verified(directory)?;
        let path = directory.join(WEIGHTS);
        let mut network = Network::new(&info.task, 0, device);
        let applied = network.load_from(&mut store(&path));
        let problem = match applied {
            Ok(applied) if applied.unused.is_empty() => None,
            Ok(applied) => Some(format!("the network has no place for {:?}", applied.unused)),
            Err(error) => Some(error.to_string()),
        };
        if let Some(problem) = problem {
            let problem = format!("its weights are not those of the network in {MODEL}: {problem}");
            return Err(Error::Checkpoint { path, problem });
        }
        Ok(Self { directory: directory.to_owned(), info, network })
    }
}

impl ModelInfo {
    /// Reads what a checkpoint's directory says of itself, its format first.
    pub fn read(directory: &Path) -> Result<Self> {
        let path = directory.join(MODEL);
        let Form { format } = read_json(&path)?;
        if format != FORMAT {
            let problem = format!("it has format {format}, and this program reads format {FORMAT}");
            return Err(Error::Checkpoint { path, problem });
        }
        let info: Self = read_json(&path)?;
        match info.fault() {
            None => Ok(info),
            Some(problem) => Err(Error::Checkpoint { path, problem }),
        }
    }

    /// What makes no network of it: it may come from anybody.
    fn fault(&self) -> Option<String> {
        if let Err(error) = self.task.validate() {
            return Some(error.to_string());
        }
        let fits = self.standardization.as_ref().is_none_or(Standardization::fits::<6>);
        (!fits).then(|| "standardization: expected 6 means and 6 scales above 0".to_owned())
    }

    /// The same, if the weights are those that it speaks of.
    pub(crate) fn verified(directory: &Path) -> Result<Self> {
        let info = Self::read(directory)?;
        verify(&directory.join(WEIGHTS), &info.weights_sha256)?;
        Ok(info)
    }

    /// Of a network that learns, or learned, a task from examples.
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

/// What a checkpoint is made of.
pub(crate) struct Contents<'a> {
    pub(crate) info: ModelInfo,
    pub(crate) config: &'a TrainConfig,
    pub(crate) network: &'a Network,
    /// Only in `last`.
    pub(crate) training: Option<Resumption<'a>>,
}

/// What a run is resumed from, beside the weights.
pub(crate) struct Resumption<'a> {
    pub(crate) optimizer: &'a AdamW,
    pub(crate) place: &'a Place,
}

/// What `training.json` says.
#[derive(Debug, Serialize, Deserialize)]
struct TrainingState {
    place: Place,
    optimizer_sha256: String,
}

impl Contents<'_> {
    /// Publishes the checkpoint, replacing the one that is there.
    pub(crate) fn save(self, directory: &Path) -> Result<()> {
        publish::replace(directory, |inside| self.write(inside))
    }

    fn write(mut self, inside: &Path) -> Result<()> {
        let weights = inside.join(WEIGHTS);
        self.network.save_into(&mut store(&weights)).map_err(|error| cannot_write(&weights, &error))?;
        self.info.weights_sha256 = digest_of_file(&weights)?;
        write_json(&inside.join(MODEL), &self.info)?;
        Description::complete(inside)?;
        write_config(&inside.join(CONFIG), self.config)?;
        let Some(Resumption { optimizer, place }) = self.training else { return Ok(()) };
        let moments = inside.join(OPTIMIZER);
        optimizer.moments.save_into(&mut store(&moments)).map_err(|error| cannot_write(&moments, &error))?;
        let optimizer_sha256 = digest_of_file(&moments)?;
        let state = TrainingState { place: place.clone(), optimizer_sha256 };
        write_json(&inside.join(TRAINING), &state)
    }
}

/// Reads what only training needs: the optimizer with its moments, and where training stands.
pub(crate) fn load_training(directory: &Path, mut optimizer: AdamW) -> Result<(AdamW, Place)> {
    let state: TrainingState = read_json(&directory.join(TRAINING))?;
    let path = directory.join(OPTIMIZER);
    verify(&path, &state.optimizer_sha256)?;
    let loaded = optimizer.moments.load_from(&mut store(&path));
    loaded.map_err(|error| Error::Checkpoint { path, problem: error.to_string() })?;
    optimizer.steps = state.place.steps;
    Ok((optimizer, state.place))
}

/// The configuration that a checkpoint was trained with.
pub(crate) fn load_config(directory: &Path) -> Result<TrainConfig> {
    let path = directory.join(CONFIG);
    let text = fs::read_to_string(&path).map_err(at(&path))?;
    toml::from_str(&text).map_err(|error| Error::Checkpoint { path, problem: error.to_string() })
}

/// Writes a configuration.
pub(crate) fn write_config(path: &Path, config: &TrainConfig) -> Result<()> {
    let text = toml::to_string(config).map_err(|error| cannot_write(path, &error))?;
    publish::write(path, &text)
}

/// Weights under the names of the parameters; the file's bytes are a function of the weights alone.
fn store(path: &Path) -> SafetensorsStore {
    SafetensorsStore::from_file(path).skip_enum_variants(true).clear_metadata()
}

fn verify(path: &Path, expected: &str) -> Result<()> {
    let found = digest_of_file(path)?;
    if found == expected {
        return Ok(());
    }
    Err(Error::Digest { path: path.to_owned(), expected: expected.to_owned(), found })
}

fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = fs::read_to_string(path).map_err(at(path))?;
    serde_json::from_str(&text)
        .map_err(|error| Error::Checkpoint { path: path.to_owned(), problem: error.to_string() })
}

pub(crate) fn write_json<T: Serialize>(path: &Path, value: &T) -> Result<()> {
    let text = serde_json::to_string_pretty(value).map_err(|error| cannot_write(path, &error))?;
    publish::write(path, &(text + "\n"))
}

fn cannot_write(path: &Path, error: &dyn std::fmt::Display) -> Error {
    Error::Checkpoint { path: path.to_owned(), problem: format!("cannot be written: {error}") }
}
