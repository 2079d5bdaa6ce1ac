//! The commands of `flowservo model`.

mod arguments;
mod exchange;

pub(crate) use arguments::{AliasArgs, Copy, Gc, NoteArgs, Yank};
pub(crate) use exchange::{Attach, Exchange, ExportFormat};

use super::registry::RegistryArgs;
use clap::Subcommand;
use std::path::PathBuf;

/// `model`
#[derive(Debug, Subcommand)]
pub(crate) enum Model {
    /// Publish a checkpoint as the next version of a model.
    #[command(after_help = "Example:\n  flowservo model publish runs/approach/best approach")]
    Publish {
        /// Checkpoint folder.
        checkpoint: PathBuf,
        /// Model name.
        name: String,
        /// Folder of an evaluation of this checkpoint. Its Table 1 is published as metrics, or attached if the version exists
        /// already.
        #[arg(long, value_name = "DIR")]
        evaluation: Option<PathBuf>,
        /// Registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// List models and their versions.
    #[command(after_help = "Example:\n  flowservo model list")]
    List {
        /// Registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Show a version: files, lineage, metrics, signatures and evaluations.
    #[command(after_help = "Example:\n  flowservo model show approach@1")]
    Show {
        /// Model: NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST.
        model: String,
        /// Registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Copy a version out of the registry and check every digest.
    #[command(after_help = "Examples:\n  flowservo model pull approach@1 --out runs/pulled\n  \
                            flowservo model pull approach@1 --out runs/pulled --public-key pub.pem")]
    Pull {
        /// Model: NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST.
        model: String,
        /// Folder for the files.
        #[arg(long)]
        out: PathBuf,
        /// Public key (PEM). Write nothing unless a signature by this key is attached to the version.
        #[arg(long, value_name = "PEM")]
        public_key: Option<PathBuf>,
        /// Registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Check all files of a model, or of the whole registry, against their digests.
    #[command(after_help = "Examples:\n  flowservo model verify\n  \
                            flowservo model verify approach@1 --public-key pub.pem\n  \
                            flowservo model verify pulled --public-key pub.pem --signature model.sig")]
    Verify {
        /// Model: NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST; with --public-key also a model folder (default: all
        /// models).
        model: Option<String>,
        /// Public key (PEM) for checking the signature of the model.
        #[arg(long, value_name = "PEM", requires = "model")]
        public_key: Option<PathBuf>,
        /// Signature file (default: one attached to the version, or model.sig in the folder).
        #[arg(long, value_name = "FILE", requires = "public_key")]
        signature: Option<PathBuf>,
        /// Registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Set, remove or list aliases: movable names of versions.
    #[command(after_help = "Examples:\n  \
                            flowservo model alias approach champion 3 --reason \"best on Table 1\"\n  \
                            flowservo model alias approach champion\n  \
                            flowservo model alias approach champion 4 --expect 3\n  \
                            flowservo model alias approach champion --remove\n  \
                            flowservo model alias approach\n\n\
                            Commands that take a model then accept approach:champion.")]
    Alias(AliasArgs),
    /// Withdraw a version: it remains available by number, but no longer counts as the newest.
    #[command(after_help = "Examples:\n  \
                            flowservo model yank approach@3 --reason \"trained on the test set\"\n  \
                            flowservo model yank approach@3 --undo")]
    Yank(Yank),
    /// Copy versions to another registry, with their attachments.
    #[command(after_help = "Examples:\n  \
                            flowservo model copy approach@3 avoid:champion --to s3://lab/models\n  \
                            flowservo model copy approach --all --aliases --registry s3://lab/models --to models\n\n\
                            Digests stay the same, and signatures stay valid. Copying again adds only what is missing.")]
    Copy(Copy),
    /// List files left behind by interrupted commands; with --delete, delete them.
    #[command(after_help = "Example:\n  flowservo model gc --delete")]
    Gc(Gc),
    /// Compare two versions: configuration, metrics, lineage, files.
    #[command(after_help = "Example:\n  flowservo model diff approach@2 approach@3")]
    Diff {
        /// First version: NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST.
        from: String,
        /// Second version.
        to: String,
        /// Registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Create a registry, or check that the store of an existing one never overwrites objects.
    #[command(
        after_help = "Examples:\n  flowservo model init\n  flowservo model init --registry s3://lab/models"
    )]
    Init {
        /// Registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Commands that exchange models with other tools.
    #[command(flatten)]
    Exchange(Exchange),
}
