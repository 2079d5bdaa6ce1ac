//! The command line: arguments only. The doc comments of commands and arguments are the text of `--help`.

mod config;
mod dataset;
mod eval;
mod model;
mod registry;
mod reproduce;
mod train;

pub(crate) use dataset::{Dataset, Show};
pub(crate) use eval::Eval;
pub(crate) use model::{AliasArgs, Attach, Copy, Exchange, ExportFormat, Gc, Model, NoteArgs, Yank};
pub(crate) use reproduce::Reproduce;
pub(crate) use train::Train;

use clap::{Parser, Subcommand};

/// Learned visual servoing in virtual environments: datasets, networks, servo sessions, and the paper's tables.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 110, arg_required_else_help = true)]
pub(crate) struct Cli {
    /// Command to run.
    #[command(subcommand)]
    pub(crate) command: Command,
    /// Number of threads (default: one per core). Results do not depend on it.
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) threads: Option<u16>,
    /// Print one JSON object as the last line of standard output.
    #[arg(long, global = true)]
    pub(crate) json: bool,
}

/// A command.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Run the whole experiment: datasets, training, servo sessions, tables and report.html.
    #[command(after_help = "Example:\n  flowservo reproduce --preset quick")]
    Reproduce(Reproduce),
    /// Generate and inspect datasets.
    #[command(subcommand)]
    Dataset(Dataset),
    /// Train a network.
    #[command(after_help = "Examples:\n  \
                      flowservo train configs/train/approach.toml --out runs/approach --set phases.0.epochs=4\n\n\
                      Start from a published model and train on other data:\n  \
                      flowservo train configs/train/approach.toml --from approach:champion --data data/b --out runs/b")]
    Train(Train),
    /// Run servo sessions and print Table 1.
    #[command(
        after_help = "Example:\n  flowservo eval configs/eval/table1.toml --approach runs/approach/best --avoid avoid@1 \\\n    \
                            --out runs/table1"
    )]
    Eval(Eval),
    /// Publish, compare, alias, pull and verify versioned models.
    #[command(subcommand)]
    Model(Model),
}
