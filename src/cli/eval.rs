//! Arguments of `flowservo eval`.

use super::config::ConfigArgs;
use super::registry::RegistryArgs;
use crate::device::DeviceChoice;
use clap::Args;
use std::path::PathBuf;

/// `eval`
#[derive(Debug, Args)]
pub(crate) struct Eval {
    /// Configuration of the evaluation.
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
    /// Model to use as `CNN_approach`, instead of the configured one: a checkpoint folder, NAME@VERSION, NAME:ALIAS, or oracle.
    #[arg(long, value_name = "MODEL")]
    pub(crate) approach: Option<String>,
    /// Model to use as `CNN_avoid`, instead of the configured one: a checkpoint folder, NAME@VERSION, NAME:ALIAS, or oracle.
    #[arg(long, value_name = "MODEL")]
    pub(crate) avoid: Option<String>,
    /// Folder for tables and sessions.
    #[arg(long)]
    pub(crate) out: PathBuf,
    /// Device that runs the networks.
    #[arg(long, value_enum, default_value = "auto")]
    pub(crate) device: DeviceChoice,
    /// Registry.
    #[command(flatten)]
    pub(crate) registry: RegistryArgs,
}
