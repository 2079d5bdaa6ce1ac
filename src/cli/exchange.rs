//! The commands of `model` that connect a registry with the rest of the world.

use super::RegistryArgs;
use clap::Subcommand;
use std::path::PathBuf;

/// The last commands of `model`.
#[derive(Debug, Subcommand)]
pub(crate) enum Exchange {
    /// Show images to a model and print what it says.
    #[command(after_help = "Example: flowservo model predict approach@1 current.png goal.png --json")]
    Predict {
        /// A checkpoint's folder, NAME or NAME@VERSION.
        model: String,
        /// PNG files: current and goal image for `CNN_approach`, the current image for `CNN_avoid`.
        #[arg(required = true, num_args = 1..=2, value_name = "IMAGE")]
        images: Vec<PathBuf>,
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
}
