//! Arguments of `flowservo reproduce`.

use crate::device::DeviceChoice;
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// `reproduce`
#[derive(Debug, Args)]
pub(crate) struct Reproduce {
    /// Size of the experiment.
    #[arg(long, value_enum, default_value = "quick")]
    pub(crate) preset: Preset,
    /// Folder with the configurations.
    #[arg(long, default_value = "configs")]
    pub(crate) configs: PathBuf,
    /// Folder for the results (default: runs/PRESET).
    #[arg(long)]
    pub(crate) out: Option<PathBuf>,
    /// Set one key of the preset, such as training.approach.phases.0.epochs=3; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) overrides: Vec<String>,
    /// Device that runs the networks.
    #[arg(long, value_enum, default_value = "auto")]
    pub(crate) device: DeviceChoice,
}

/// Size of the experiment.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum Preset {
    /// Small images and small networks; takes less than ten minutes on two CPU cores.
    Quick,
    /// Larger images and longer training; takes about an hour on two CPU cores.
    Cpu,
    /// VGA images and full-width networks; needs a GPU.
    Paper,
}

impl Preset {
    /// Returns the name on the command line and in `configs/reproduce`.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Quick => "quick",
            Self::Cpu => "cpu",
            Self::Paper => "paper",
        }
    }
}
