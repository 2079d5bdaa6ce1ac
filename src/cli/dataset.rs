//! Arguments of `flowservo dataset`.

use super::config::ConfigArgs;
use clap::{Args, Subcommand};
use datagen::Part;
use std::path::PathBuf;

/// `dataset`
#[derive(Debug, Subcommand)]
pub(crate) enum Dataset {
    /// Generate a dataset, or continue an interrupted run.
    #[command(after_help = "Examples:\n  \
                            flowservo dataset generate configs/datasets/a.toml --out runs/data/a --set count=4000\n\n\
                            On two machines that share the folder, or with folders that are merged afterward:\n  \
                            flowservo dataset generate configs/datasets/a.toml --out runs/data/a --shard 1/2\n  \
                            flowservo dataset generate configs/datasets/a.toml --out runs/data/a --shard 2/2\n  \
                            flowservo dataset finish runs/data/a")]
    Generate {
        /// Configuration of the dataset.
        #[command(flatten)]
        config: ConfigArgs,
        /// Folder for the dataset.
        #[arg(long)]
        out: PathBuf,
        /// Generate only part I of N (every N-th file); complete the dataset with `dataset finish`.
        #[arg(long, value_name = "I/N")]
        shard: Option<Part>,
    },
    /// Complete a dataset generated with --shard: check all files, write the card and dataset.json.
    #[command(after_help = "Example:\n  flowservo dataset finish runs/data/a")]
    Finish {
        /// Dataset folder.
        dataset: PathBuf,
    },
    /// Describe a dataset: counts, ranges, statistics of the labels, sizes.
    #[command(after_help = "Example:\n  flowservo dataset info runs/data/a")]
    Info {
        /// Dataset folder.
        dataset: PathBuf,
    },
    /// Draw a contact sheet of some rows: images with their motion or their avoidance map.
    #[command(after_help = "Example:\n  flowservo dataset show runs/data/a --rows 0,5,17")]
    Show(Show),
    /// Check every byte of a dataset and list all files that have changed.
    #[command(after_help = "Example:\n  flowservo dataset verify runs/data/a --json")]
    Verify {
        /// Dataset folder.
        dataset: PathBuf,
    },
    /// Generate one row again and compare it with the stored row.
    #[command(after_help = "Example:\n  flowservo dataset replay runs/data/a 17 --out runs/replay")]
    Replay {
        /// Dataset folder.
        dataset: PathBuf,
        /// Row number, from 0.
        row: u64,
        /// Folder for PNG files of the regenerated and the stored images.
        #[arg(long)]
        out: Option<PathBuf>,
    },
}

/// `dataset show`
#[derive(Debug, Args)]
pub(crate) struct Show {
    /// Dataset folder.
    pub(crate) dataset: PathBuf,
    /// SVG file for the contact sheet (default: NAME-sheet.svg, with the name of the dataset).
    #[arg(long, value_name = "FILE")]
    pub(crate) out: Option<PathBuf>,
    /// Row numbers, from 0.
    #[arg(long, value_name = "ROW,ROW", value_delimiter = ',', conflicts_with_all = ["count", "seed"])]
    pub(crate) rows: Vec<u64>,
    /// Number of rows, spread evenly over the dataset.
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = clap::value_parser!(u64).range(1..=1000))]
    pub(crate) count: u64,
    /// Seed for a random choice of rows instead of an even one.
    #[arg(long, value_name = "SEED")]
    pub(crate) seed: Option<u64>,
}
