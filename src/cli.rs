//! The command line.

mod exchange;
mod model;

pub(crate) use exchange::{Attach, Exchange, ExportFormat};
pub(crate) use model::{AliasArgs, Copy, Gc, NoteArgs, Yank};

use crate::device::DeviceChoice;
use clap::{Args, Parser, Subcommand, ValueEnum};
use datagen::Part;
use registry::Location;
use std::path::PathBuf;

/// Learned visual servoing in virtual environments: datasets, networks, servo sessions, and the paper's tables.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 110, arg_required_else_help = true)]
pub(crate) struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub(crate) command: Command,
    /// Threads to compute with; all cores by default. Results do not depend on it.
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) threads: Option<u16>,
    /// Print one JSON object on the last line of standard output.
    #[arg(long, global = true)]
    pub(crate) json: bool,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Run everything: data, training, servo sessions, tables and report.html.
    #[command(after_help = "Example: flowservo reproduce --preset quick")]
    Reproduce(Reproduce),
    /// Make datasets and look into them.
    #[command(subcommand)]
    Dataset(Dataset),
    /// Train a network.
    #[command(after_help = "Examples:\n  \
                      flowservo train configs/train/approach.toml --out runs/approach --set phases.0.epochs=4\n\n\
                      From a trained model on other data, as exactly what it is:\n  \
                      flowservo train configs/train/approach.toml --from approach:champion --data data/mine --out runs/mine")]
    Train(Train),
    /// Run servo sessions and print Table 1.
    #[command(after_help = "Example: flowservo eval configs/eval/table1.toml --approach runs/approach/best \
                            --avoid avoid@1 --out runs/table1")]
    Eval(Eval),
    /// Publish, compare, name, pull and verify versioned model checkpoints.
    #[command(subcommand)]
    Model(Model),
}

/// A configuration file and what is changed in it.
#[derive(Debug, Args)]
pub(crate) struct ConfigArgs {
    /// The configuration, a TOML file.
    pub(crate) config: PathBuf,
    /// Change one key of the configuration; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) overrides: Vec<String>,
}

/// `reproduce`
#[derive(Debug, Args)]
pub(crate) struct Reproduce {
    /// How much of everything.
    #[arg(long, value_enum, default_value = "quick")]
    pub(crate) preset: Preset,
    /// Folder of the configurations.
    #[arg(long, default_value = "configs")]
    pub(crate) configs: PathBuf,
    /// Where to write; runs/PRESET by default.
    #[arg(long)]
    pub(crate) out: Option<PathBuf>,
    /// Change one key of the preset, as training.approach.phases.0.epochs=3; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) overrides: Vec<String>,
    /// Where to train.
    #[arg(long, value_enum, default_value = "auto")]
    pub(crate) device: DeviceChoice,
}

/// A size of `reproduce`.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub(crate) enum Preset {
    /// Minutes on two CPU cores.
    Quick,
    /// All 52,000 examples with the small network: hours on a CPU.
    Cpu,
    /// VGA and full-width networks, for a graphics processor.
    Paper,
}

impl Preset {
    /// Its name on the command line and in `configs/reproduce`.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Quick => "quick",
            Self::Cpu => "cpu",
            Self::Paper => "paper",
        }
    }
}

/// `dataset`
#[derive(Debug, Subcommand)]
pub(crate) enum Dataset {
    /// Sample, render and write a dataset, or what is missing of it.
    #[command(after_help = "Examples:\n  \
                            flowservo dataset generate configs/datasets/a.toml --out runs/data/a --set count=4000\n\n\
                            On two machines that share the folder, or whose folders are copied together after:\n  \
                            flowservo dataset generate configs/datasets/a.toml --out runs/data/a --shard 1/2\n  \
                            flowservo dataset generate configs/datasets/a.toml --out runs/data/a --shard 2/2\n  \
                            flowservo dataset finish runs/data/a")]
    Generate {
        /// The dataset's configuration.
        #[command(flatten)]
        config: ConfigArgs,
        /// Folder to write.
        #[arg(long)]
        out: PathBuf,
        /// Make only part I of N of the files, every N-th; `dataset finish` completes the dataset.
        #[arg(long, value_name = "I/N")]
        shard: Option<Part>,
    },
    /// Complete a dataset whose parts were made with --shard: check every file, write card and dataset.json.
    #[command(after_help = "Example: flowservo dataset finish runs/data/a")]
    Finish {
        /// The dataset's folder.
        dataset: PathBuf,
    },
    /// Show what a dataset holds: counts, ranges, statistics of the labels, sizes.
    #[command(after_help = "Example: flowservo dataset info runs/data/a")]
    Info {
        /// The dataset's folder.
        dataset: PathBuf,
    },
    /// Draw some rows on a contact sheet: images with their motion, or with their avoidance map.
    #[command(after_help = "Example: flowservo dataset show runs/data/a --rows 0,5,17")]
    Show(Show),
    /// Compare every byte of a dataset with what was written, and name all files that differ.
    #[command(after_help = "Example: flowservo dataset verify runs/data/a --json")]
    Verify {
        /// The dataset's folder.
        dataset: PathBuf,
    },
    /// Make a row again and compare it with what is stored.
    #[command(after_help = "Example: flowservo dataset replay runs/data/a 17 --out runs/replay")]
    Replay {
        /// The dataset's folder.
        dataset: PathBuf,
        /// Number of the row, from 0.
        row: u64,
        /// Folder for the row's images as they are made now and as they are stored, as PNG.
        #[arg(long)]
        out: Option<PathBuf>,
    },
}

/// `dataset show`
#[derive(Debug, Args)]
pub(crate) struct Show {
    /// The dataset's folder.
    pub(crate) dataset: PathBuf,
    /// The drawing, an SVG file; NAME-sheet.svg by default, with the dataset's name.
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// Which rows, counted from 0.
    #[arg(long, value_name = "ROW,ROW", value_delimiter = ',', conflicts_with_all = ["count", "seed"])]
    pub(crate) rows: Vec<u64>,
    /// How many rows, spread evenly over the dataset.
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u64).range(1..=1000))]
    pub(crate) count: u64,
    /// Draw the rows by chance from this seed.
    #[arg(long, value_name = "SEED")]
    pub(crate) seed: Option<u64>,
}

/// `train`
#[derive(Debug, Args)]
pub(crate) struct Train {
    /// The training configuration.
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
    /// A dataset's folder, in the place of those in the configuration; may be repeated.
    #[arg(long)]
    pub(crate) data: Vec<PathBuf>,
    /// Begin from this model, in the place of the configuration's `parent`: a checkpoint's folder, NAME@VERSION or NAME:ALIAS.
    #[arg(long, value_name = "MODEL")]
    pub(crate) from: Option<String>,
    /// Folder of the run: checkpoints and metrics.
    #[arg(long)]
    pub(crate) out: PathBuf,
    /// Go on where an interrupted run stopped.
    #[arg(long)]
    pub(crate) resume: bool,
    /// Where to train.
    #[arg(long, value_enum, default_value = "auto")]
    pub(crate) device: DeviceChoice,
    /// The registry.
    #[command(flatten)]
    pub(crate) registry: RegistryArgs,
}

/// `eval`
#[derive(Debug, Args)]
pub(crate) struct Eval {
    /// The evaluation's configuration.
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
    /// `CNN_approach` in the place of the configuration's: a checkpoint's folder, NAME@VERSION, NAME:ALIAS, or oracle.
    #[arg(long, value_name = "MODEL")]
    pub(crate) approach: Option<String>,
    /// `CNN_avoid` in the place of the configuration's: a checkpoint's folder, NAME@VERSION, NAME:ALIAS, or oracle.
    #[arg(long, value_name = "MODEL")]
    pub(crate) avoid: Option<String>,
    /// Folder for tables and sessions.
    #[arg(long)]
    pub(crate) out: PathBuf,
    /// Where to run the networks.
    #[arg(long, value_enum, default_value = "auto")]
    pub(crate) device: DeviceChoice,
    /// The registry.
    #[command(flatten)]
    pub(crate) registry: RegistryArgs,
}

/// Where the registry is.
#[derive(Debug, Args)]
pub(crate) struct RegistryArgs {
    /// The model registry: a folder, or `s3://BUCKET/PREFIX` (server and credentials from the usual AWS variables).
    #[arg(long, value_name = "PLACE", default_value = "models")]
    pub(crate) registry: Location,
}

/// `model`
#[derive(Debug, Subcommand)]
pub(crate) enum Model {
    /// Publish a checkpoint as the next version of a name.
    #[command(after_help = "Example: flowservo model publish runs/approach/best approach")]
    Publish {
        /// The checkpoint's folder.
        checkpoint: PathBuf,
        /// The model's name.
        name: String,
        /// Folder of an evaluation of this checkpoint. Its Table 1 is published as metrics, or attached if the version
        /// exists.
        #[arg(long, value_name = "DIR")]
        evaluation: Option<PathBuf>,
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// List models and their versions.
    #[command(after_help = "Example: flowservo model list")]
    List {
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Show a version: files, lineage, metrics, signatures and evaluations.
    #[command(after_help = "Example: flowservo model show approach@1")]
    Show {
        /// NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST.
        model: String,
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Write the files of a version to a folder, with every digest verified.
    #[command(after_help = "Examples:\n  flowservo model pull approach@1 --out runs/pulled\n  \
                            flowservo model pull approach@1 --out runs/pulled --public-key pub.pem")]
    Pull {
        /// NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST.
        model: String,
        /// Folder to write.
        #[arg(long)]
        out: PathBuf,
        /// Write nothing unless the version has a valid signature by this key, a PEM file.
        #[arg(long, value_name = "PEM")]
        public_key: Option<PathBuf>,
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Verify every file of a model, or of the whole registry.
    #[command(after_help = "Examples:\n  flowservo model verify\n  \
                            flowservo model verify approach@1 --public-key pub.pem\n  \
                            flowservo model verify pulled --public-key pub.pem --signature model.sig")]
    Verify {
        /// NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST. The default is everything. With --public-key,
        /// also a model folder.
        model: Option<String>,
        /// Verify the model's signature with this key, a PEM file.
        #[arg(long, value_name = "PEM", requires = "model")]
        public_key: Option<PathBuf>,
        /// File of the signature. The default is an attached one for a version, and model.sig for a folder.
        #[arg(long, value_name = "FILE", requires = "public_key")]
        signature: Option<PathBuf>,
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Set an alias of a version, show its history, end it, or list all aliases.
    #[command(after_help = "Examples:\n  \
                            flowservo model alias approach champion 3 --reason \"best on Table 1\"\n  \
                            flowservo model alias approach champion\n  \
                            flowservo model alias approach champion 4 --expect 3\n  \
                            flowservo model alias approach champion --remove\n  \
                            flowservo model alias approach\n\n\
                            Any command that takes a model also takes approach:champion.")]
    Alias(AliasArgs),
    /// Mark a version that should no longer be used. It is not deleted, but no longer the newest.
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
    /// Show unused files, left by interrupted commands, and delete them on request.
    #[command(after_help = "Example: flowservo model gc --delete")]
    Gc(Gc),
    /// Show the differences between two versions: configuration, metrics, lineage, files.
    #[command(after_help = "Example: flowservo model diff approach@2 approach@3")]
    Diff {
        /// The first version: NAME, NAME@VERSION, NAME:ALIAS or NAME@sha256:DIGEST.
        from: String,
        /// The second version.
        to: String,
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Create a registry, or test whether an existing one is safe: its store must never overwrite an object.
    #[command(
        after_help = "Examples:\n  flowservo model init\n  flowservo model init --registry s3://lab/models"
    )]
    Init {
        /// The registry.
        #[command(flatten)]
        registry: RegistryArgs,
    },
    /// Commands that exchange models with other tools.
    #[command(flatten)]
    Exchange(Exchange),
}
