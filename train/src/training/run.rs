//! A training run and its folder.
//!
//! ```text
//! config.toml     the configuration
//! metrics.jsonl   one line per epoch
//! tensorboard/    the same and individual steps, as TensorBoard's event files
//! last/           checkpoint with the training state, from which to resume
//! best/           checkpoint of the epoch with the lowest validation loss
//! ```

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use burn::tensor::Device;

use crate::checkpoint::lineage::Program;
use crate::checkpoint::publish;
use crate::checkpoint::warm_start::WarmStart;
use crate::config::TrainConfig;
use crate::metrics::journal::Telemetry;

/// A training run.
pub struct Run<'a> {
    /// Configuration.
    pub config: &'a TrainConfig,
    /// Folder of the results.
    pub directory: &'a Path,
    /// Device to compute on.
    pub device: &'a Device,
    /// Display name of the device.
    pub device_name: &'a str,
    /// Program version to record in checkpoints, if any.
    pub program: Option<&'a Program>,
    /// The model named by [`parent`](TrainConfig::parent), which a new run starts from.
    pub warm_start: Option<&'a WarmStart>,
    /// Whether to resume the run in `directory` instead of starting one there.
    pub resume: bool,
    /// Checked before every batch. If set, the state is saved and the run ends with
    /// [`Error::Interrupted`](crate::Error::Interrupted).
    pub stop: &'a AtomicBool,
    /// Reads clock and memory. Used for the journal only.
    pub telemetry: &'a dyn Fn() -> Telemetry,
}

impl Run<'_> {
    /// Returns the device with automatic differentiation.
    pub(crate) fn autodiff(&self) -> Device {
        self.device.clone().autodiff()
    }

    /// Returns the folder of the checkpoint to resume from.
    pub(crate) fn last(&self) -> PathBuf {
        last(self.directory)
    }

    /// Returns the folder of the checkpoint with the lowest validation loss.
    pub(crate) fn best(&self) -> PathBuf {
        self.directory.join("best")
    }

    /// Returns whether the run has to stop.
    pub(crate) fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Returns whether a folder holds a run that can be resumed.
pub fn can_resume(directory: &Path) -> bool {
    publish::recover(&last(directory)).is_ok() && last(directory).exists()
}

fn last(directory: &Path) -> PathBuf {
    directory.join("last")
}
