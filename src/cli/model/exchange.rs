//! Arguments of the commands of `flowservo model` that exchange models with other tools.

use super::arguments::NoteArgs;
use crate::cli::registry::RegistryArgs;
use clap::{Args, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Commands that exchange models with other tools.
#[derive(Debug, Subcommand)]
pub(crate) enum Exchange {
    /// Run a model on images and print its output.
    #[command(after_help = "Example:\n  flowservo model predict approach@1 current.png goal.png --json")]
    Predict {
        /// Model: a checkpoint folder, or NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST.
        model: String,
        /// PNG files: current and goal image for `CNN_approach`, the current image for `CNN_avoid`.
        #[arg(required = true, num_args = 1..=2, value_name = "IMAGE")]
        images: Vec<PathBuf>,
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Sign a version with your own key, offline (OpenSSF Model Signing). The signature is attached to the version.
    #[command(after_help = "Examples:\n  \
                            openssl ecparam -name prime256v1 -genkey -noout -out key.pem\n  \
                            openssl ec -in key.pem -pubout -out pub.pem\n  \
                            flowservo model sign approach@1 --key key.pem\n  \
                            flowservo model verify approach@1 --public-key pub.pem\n  \
                            flowservo model pull approach@1 --public-key pub.pem --out pulled\n\n\
                            The signature covers the files that `model pull` writes. Other tools can verify a signature written \
                            with --out approach-1.sig:\n  \
                            model_signing verify key FOLDER --signature approach-1.sig --public_key pub.pem")]
    Sign {
        /// Model: NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST, or a model folder.
        model: String,
        /// Private key on the curve NIST P-256: a PEM file without a password.
        #[arg(long, value_name = "PEM")]
        key: PathBuf,
        /// New file for the signature. For a model folder, the default is model.sig.
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Attach an evaluation, or a signature by another tool, to a published version.
    #[command(after_help = "Examples:\n  \
                            flowservo model attach approach@1 --evaluation runs/table1\n  \
                            flowservo model attach approach@1 --signature approach-1.sig\n\n\
                            Of several evaluations, the last one counts. Attachments are never removed.")]
    Attach(Attach),
    /// Export a version as a folder for the Hugging Face Hub or an OCI image layout for container registries.
    #[command(after_help = "Examples:\n  \
                            flowservo model export approach@1 --format huggingface --license apache-2.0 --out hub\n  \
                            hf upload USER/approach hub\n\n  \
                            flowservo model export approach@1 --format oci --out layout\n  \
                            skopeo copy oci:layout:1 docker://HOST/approach:1\n\n\
                            `flowservo model import` reads both.")]
    Export {
        /// Model: NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST.
        model: String,
        /// Format to write.
        #[arg(long, value_enum)]
        format: ExportFormat,
        /// New folder to write.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// License for the Hugging Face card, by the Hub's identifier: apache-2.0, cc-by-4.0.
        #[arg(long, value_name = "ID")]
        license: Option<String>,
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Publish an exported model, with every digest verified.
    #[command(after_help = "Example:\n  flowservo model import layout approach")]
    Import {
        /// An OCI image layout, or a folder for the Hugging Face Hub.
        folder: PathBuf,
        /// Name of the model in this registry.
        name: String,
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
}

/// `model attach`
#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("attachment").required(true).args(["evaluation", "signature"])))]
pub(crate) struct Attach {
    /// Model: NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST.
    pub(crate) model: String,
    /// Folder of an evaluation of this version. Its Table 1 is attached.
    #[arg(long, value_name = "DIR")]
    pub(crate) evaluation: Option<PathBuf>,
    /// Signature of the files of this version: a Sigstore bundle (OpenSSF Model Signing).
    #[arg(long, value_name = "FILE")]
    pub(crate) signature: Option<PathBuf>,
    /// Reason and author.
    #[command(flatten)]
    pub(crate) note: NoteArgs,
    /// The registry.
    #[command(flatten)]
    pub(crate) registry: RegistryArgs,
}

/// A format of other tools.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ExportFormat {
    /// A folder for the Hugging Face Hub: card, config.json, model.safetensors.
    Huggingface,
    /// An OCI image layout.
    Oci,
}
