//! The commands of `model` that connect a registry with the rest of the world.

use super::model::RemarkArgs;
use super::registry::RegistryArgs;
use clap::{Args, Subcommand, ValueEnum};
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
    /// Sign a version (OpenSSF Model Signing), offline, with a key of your own. The signature is attached to the version.
    #[command(after_help = "Examples:\n  \
                            openssl ecparam -name prime256v1 -genkey -noout -out key.pem\n  \
                            openssl ec -in key.pem -pubout -out pub.pem\n  \
                            flowservo model sign approach@1 --key key.pem\n  \
                            flowservo model verify approach@1 --public-key pub.pem\n  \
                            flowservo model pull approach@1 --public-key pub.pem --out pulled\n\n\
                            The signature holds for the files as `model pull` writes them, and with --out approach-1.sig \
                            other tools verify it:\n  \
                            model_signing verify key FOLDER --signature approach-1.sig --public_key pub.pem")]
    Sign {
        /// NAME, NAME@VERSION or NAME@sha256:DIGEST, or a model's folder.
        model: String,
        /// Private key on the curve NIST P-256, a PEM file without password.
        #[arg(long, value_name = "PEM")]
        key: PathBuf,
        /// A new file for the signature; of a folder model.sig by default.
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Attach to a version what was made after it was published: an evaluation, or a signature by another tool.
    #[command(after_help = "Examples:\n  \
                            flowservo model attach approach@1 --evaluation runs/table1\n  \
                            flowservo model attach approach@1 --signature approach-1.sig\n\n\
                            Of evaluations the last one counts. Nothing that is attached is ever taken away.")]
    Attach(Attach),
    /// Write a version as a folder for the Hugging Face Hub, or as an OCI image layout for container registries.
    #[command(after_help = "Examples:\n  \
                            flowservo model export approach@1 --format huggingface --license apache-2.0 --out hub\n  \
                            hf upload USER/approach hub\n\n  \
                            flowservo model export approach@1 --format oci --out layout\n  \
                            skopeo copy oci:layout:1 docker://HOST/approach:1\n\n\
                            `flowservo model import` reads both.")]
    Export {
        /// NAME, NAME@VERSION or NAME@sha256:DIGEST.
        model: String,
        /// What to write.
        #[arg(long, value_enum)]
        format: ExportFormat,
        /// Folder to write; a new one.
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
        /// The license that a Hugging Face card states, as the Hub calls it: apache-2.0, cc-by-4.0.
        #[arg(long, value_name = "ID")]
        license: Option<String>,
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Publish a model that was exported, with every digest checked.
    #[command(after_help = "Example: flowservo model import layout approach")]
    Import {
        /// An OCI image layout, or a folder for the Hugging Face Hub.
        folder: PathBuf,
        /// The model's name here.
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
    /// NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST.
    pub(crate) model: String,
    /// Folder of servo sessions with this version: Table 1's figures.
    #[arg(long, value_name = "DIR")]
    pub(crate) evaluation: Option<PathBuf>,
    /// A signature of this version's files, a Sigstore bundle by OpenSSF Model Signing.
    #[arg(long, value_name = "FILE")]
    pub(crate) signature: Option<PathBuf>,
    /// Why, and who says so.
    #[command(flatten)]
    pub(crate) remark: RemarkArgs,
    /// The registry.
    #[command(flatten)]
    pub(crate) registry: RegistryArgs,
}

/// A form in which others take models.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum ExportFormat {
    /// A folder for the Hugging Face Hub: card, config.json, model.safetensors.
    Huggingface,
    /// An OCI image layout.
    Oci,
}
