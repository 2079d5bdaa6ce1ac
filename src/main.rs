//! `flowservo`: combines the libraries into a program. Only this crate prints and chooses devices.

#![forbid(unsafe_code)]
// Burn's wgpu types are nested deeper than the default limit.
#![recursion_limit = "256"]

mod cli;
mod clock;
mod commands;
mod config;
mod device;
mod error;
mod file;
mod memory;
mod output;
mod progress;
mod stop;

use crate::output::note;
use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    train::memory::keep_freed();
    match commands::run(&cli::Cli::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            note!("error: {}", error::message(&error));
            error::exit_code(&error)
        }
    }
}
