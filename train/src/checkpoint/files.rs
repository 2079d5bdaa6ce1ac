//! The files of a checkpoint: names, formats and digests.

use std::fs;
use std::path::Path;

use burn_store::SafetensorsStore;
use datagen::digest::digest_of_file;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::publish;
use crate::config::TrainConfig;
use crate::error::{Error, Result, at};

/// Name of the file with the [`ModelInfo`](super::ModelInfo).
pub const MODEL: &str = "model.json";
/// Name of the file with the weights.
pub const WEIGHTS: &str = "weights.safetensors";
/// Name of the file with the training configuration.
pub(crate) const CONFIG: &str = "config.toml";
/// Name of the file with the [`TrainingState`](super::training_state::TrainingState).
pub(crate) const TRAINING: &str = "training.json";
/// Name of the file with the moments of the optimizer.
pub(crate) const OPTIMIZER: &str = "optimizer.safetensors";

/// Returns the store of a file with parameters, by name. Its bytes are a function of the parameters alone.
pub(crate) fn store(path: &Path) -> SafetensorsStore {
    SafetensorsStore::from_file(path).clear_metadata()
}

/// Checks the digest of a file.
pub(crate) fn verify(path: &Path, expected: &str) -> Result<()> {
    let found = digest_of_file(path)?;
    if found == expected {
        return Ok(());
    }
    Err(Error::Digest { path: path.to_owned(), expected: expected.to_owned(), found })
}

/// Reads the training configuration of a checkpoint.
pub(crate) fn read_config(directory: &Path) -> Result<TrainConfig> {
    let path = directory.join(CONFIG);
    let text = fs::read_to_string(&path).map_err(at(&path))?;
    toml::from_str(&text).map_err(|error| invalid(&path, &error))
}

/// Writes a training configuration to a folder.
pub(crate) fn write_config(directory: &Path, config: &TrainConfig) -> Result<()> {
    let path = directory.join(CONFIG);
    let text = toml::to_string(config).map_err(|error| cannot_write(&path, &error))?;
    publish::write(&path, &text)
}

/// Reads a JSON file.
pub(crate) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = fs::read_to_string(path).map_err(at(path))?;
    serde_json::from_str(&text).map_err(|error| invalid(path, &error))
}

/// Writes a JSON file.
pub(crate) fn write_json<T: Serialize>(path: &Path, value: &T) -> Result<()> {
    let text = serde_json::to_string_pretty(value).map_err(|error| cannot_write(path, &error))?;
    publish::write(path, &(text + "\n"))
}

/// Returns the error for an invalid file.
pub(crate) fn invalid(path: &Path, problem: &dyn ToString) -> Error {
    Error::Checkpoint { path: path.to_owned(), problem: problem.to_string() }
}

/// Returns the error for a file that cannot be written.
pub(crate) fn cannot_write(path: &Path, error: &dyn ToString) -> Error {
    invalid(path, &format!("cannot be written: {}", error.to_string()))
}
