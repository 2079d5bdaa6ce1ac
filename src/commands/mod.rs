//! The commands: each reads its configuration, lets a crate do the work, shows how it goes, and prints the result.

mod dataset;
mod eval;
mod inspect;
mod model;
mod model_alias;
mod model_attach;
mod model_command;
mod model_copy;
mod model_diff;
mod model_export;
mod model_gc;
mod model_publish;
mod model_show;
mod model_sign;
mod predict;
mod provenance;
mod replay;
mod report;
mod reproduce;
mod train;
mod warm_start;

use crate::cli::{Cli, Command};
use crate::output::out;
use crate::stop::Stop;
use anyhow::{Context, Result};
use serde::Serialize;
use std::io::Write;
use std::path::Path;

/// Runs what the command line asks for.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    if let Some(threads) = cli.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into());
        pool.build_global().context("the threads could not be started")?;
    }
    match &cli.command {
        Command::Reproduce(arguments) => reproduce::run(arguments, &Stop::listen()?, cli.json),
        Command::Dataset(command) => dataset::run(command, &Stop::listen()?, cli.json),
        Command::Train(arguments) => train::run(arguments, &Stop::listen()?, cli.json),
        Command::Eval(arguments) => eval::run(arguments, &Stop::listen()?, cli.json),
        // Ctrl-C ends it at once: a registry is whole wherever that happens.
        Command::Model(command) => model_command::run(command, cli.json),
    }
}

/// With `--json`, prints a result as one line on standard output.
fn print_json(asked: bool, result: &impl Serialize) -> Result<()> {
    if asked {
        out!("{}", serde_json::to_string(result)?);
    }
    Ok(())
}

/// Writes a file beside its place and moves it there when it is whole.
fn write_file(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let write = || -> Result<()> {
        std::fs::create_dir_all(folder)?;
        datagen::publish::publish(path, |file| Ok(file.write_all(content.as_ref())?))
    };
    write().with_context(|| format!("{}: cannot be written", path.display()))
}
