//! `flowservo`: the one place that prints, knows devices and terminals, and wires the crates together.

#![forbid(unsafe_code)]
// Burn's wgpu types nest deeper than the default allows.
#![recursion_limit = "256"]

mod cli;
mod clock;
mod commands;
mod config;
mod device;
mod output;
mod progress;
mod stop;

use crate::output::note;
use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    train::memory::keep_freed();
    let cli = cli::Cli::parse();
    match commands::run(&cli) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            note!("error: {}", config::in_words(&error));
            let usage = error.chain().any(<dyn std::error::Error>::is::<config::BadInput>);
            ExitCode::from(if usage { 2 } else { 1 })
        }
    }
}
