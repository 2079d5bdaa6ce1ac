//! Arguments of `flowservo train`.

use super::config::ConfigArgs;
use super::registry::RegistryArgs;
use crate::device::DeviceChoice;
use clap::Args;
use std::path::PathBuf;

/// `train`
#[derive(Debug, Args)]
pub(crate) struct Train {
    /// Training configuration.
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
    /// Dataset folder, instead of those in the configuration; may be repeated.
    #[arg(long)]
    pub(crate) data: Vec<PathBuf>,
    /// Model to start from, instead of the configured `parent`: a checkpoint folder, NAME@VERSION or NAME:ALIAS.
    #[arg(long, value_name = "MODEL")]
    pub(crate) from: Option<String>,
    /// Folder of the run, for checkpoints and metrics.
    #[arg(long)]
    pub(crate) out: PathBuf,
    /// Continue an interrupted run.
    #[arg(long)]
    pub(crate) resume: bool,
    /// Device to train on.
    #[arg(long, value_enum, default_value = "auto")]
    pub(crate) device: DeviceChoice,
    /// Registry.
    #[command(flatten)]
    pub(crate) registry: RegistryArgs,
}
