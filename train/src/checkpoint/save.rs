//! Writing a checkpoint.

use std::path::Path;

use burn_store::ModuleSnapshot;
use datagen::digest::digest_of_file;

use super::description::Description;
use super::files::{MODEL, WEIGHTS, cannot_write, store, write_config, write_json};
use super::model_info::ModelInfo;
use super::publish;
use super::training_state::TrainingState;
use crate::config::TrainConfig;
use crate::error::Result;
use crate::network::Network;
use crate::optimizer::adamw::AdamW;

/// The contents of a checkpoint.
pub(crate) struct Snapshot<'a> {
    /// Contents of `model.json`, without the digest of the weights.
    pub(crate) info: ModelInfo,
    pub(crate) config: &'a TrainConfig,
    pub(crate) network: &'a Network,
    /// State from which training can resume; only in `last`.
    pub(crate) training: Option<(&'a TrainingState, &'a AdamW)>,
}

impl Snapshot<'_> {
    /// Publishes the checkpoint and replaces the previous one.
    pub(crate) fn save(self, directory: &Path) -> Result<()> {
        publish::replace(directory, |inside| self.write(inside))
    }

    fn write(mut self, inside: &Path) -> Result<()> {
        let weights = inside.join(WEIGHTS);
        self.network.save_into(&mut store(&weights)).map_err(|error| cannot_write(&weights, &error))?;
        self.info.weights_sha256 = digest_of_file(&weights)?;
        write_json(&inside.join(MODEL), &self.info)?;
        Description::complete(inside)?;
        write_config(inside, self.config)?;
        let Some((state, optimizer)) = self.training else { return Ok(()) };
        state.write(optimizer, inside)
    }
}
