//! The commands. Each reads its configuration, calls a library, shows the progress, and prints the result.

mod dataset;
mod eval;
mod lookup;
mod model;
mod reproduce;
mod train;

use crate::cli::{Cli, Command};
use crate::stop::Stop;
use anyhow::{Context, Result};

/// Runs the command that the command line selects.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    if let Some(threads) = cli.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into());
        pool.build_global().context("cannot start the threads")?;
    }
    match &cli.command {
        Command::Reproduce(arguments) => reproduce::run(arguments, &Stop::listen()?, cli.json),
        Command::Dataset(command) => dataset::run(command, &Stop::listen()?, cli.json),
        Command::Train(arguments) => train::run(arguments, &Stop::listen()?, cli.json),
        Command::Eval(arguments) => eval::run(arguments, &Stop::listen()?, cli.json),
        // Ctrl-C ends these immediately, since a registry is consistent at any moment.
        Command::Model(command) => model::run(command, cli.json),
    }
}
