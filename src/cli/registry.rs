//! The argument that locates the model registry.

use clap::Args;
use registry::Location;

/// Location of the registry.
#[derive(Debug, Args)]
pub(crate) struct RegistryArgs {
    /// Model registry: a folder, or `s3://BUCKET/PREFIX` (server and credentials from the usual AWS variables).
    #[arg(long, value_name = "LOCATION", default_value = "models")]
    pub(crate) registry: Location,
}
