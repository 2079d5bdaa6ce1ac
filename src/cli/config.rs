//! Arguments that select a configuration.

use clap::Args;
use std::path::PathBuf;

/// A configuration file and changes to it.
#[derive(Debug, Args)]
pub(crate) struct ConfigArgs {
    /// Configuration file (TOML).
    pub(crate) config: PathBuf,
    /// Set one key of the configuration; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) overrides: Vec<String>,
}
