//! `flowservo reproduce`: all stages of the paper's experiment.
//!
//! ```text
//! runs/quick/config.toml               complete configuration
//! runs/quick/datasets/a-1f3c9a2b/      datasets
//! runs/quick/training/approach-.../    networks
//! runs/quick/registry/                 the trained networks as published versions, with the figures of Table 1
//! runs/quick/evaluation/plain-.../     servo sessions, step by step
//! runs/quick/table1.{txt,md,csv,json}  Table 1
//! runs/quick/results.json              results of all stages, as with --json
//! runs/quick/report.html               everything on one page
//! ```
//!
//! The digits in the folder name of a stage are a digest of all its inputs. A finished stage is therefore reused until one of its
//! inputs changes.

mod config;
mod report;
mod results;
mod stages;

use config::ExperimentConfig;
use results::ExperimentResults;
use stages::Stages;

use super::eval;
use crate::cli;
use crate::device::{self, Opened};
use crate::file::write_file;
use crate::output::{note, out, print_json};
use crate::stop::Stop;
use ::eval::results::system::System;
use ::eval::results::table_1;
use anyhow::Result;
use std::path::Path;
use std::time::Instant;

/// Runs the command.
pub(crate) fn run(arguments: &cli::Reproduce, stop: &Stop, json: bool) -> Result<()> {
    let started = Instant::now();
    let preset = arguments.preset.name();
    let config = ExperimentConfig::load(arguments)?;
    let out = arguments.out.clone().unwrap_or_else(|| Path::new("runs").join(preset));
    write_file(&out.join("config.toml"), toml::to_string(&config)?)?;
    let device = device::open(arguments.device)?;
    note!("reproduce: preset {preset}, into {}, on {}", out.display(), device.name);

    let reproduced = run_stages(config, &out, &device, stop).map_err(|error| {
        if stop.is_raised() { error.context("stopped; run the same command to continue") } else { error }
    })?;

    let systems: Vec<System> = reproduced.systems.iter().map(|(system, _)| system.clone()).collect();
    eval::write_tables(&out, &systems)?;
    let results = reproduced.to_json(started.elapsed().as_secs_f64());
    write_file(&out.join("results.json"), serde_json::to_string_pretty(&results)?)?;
    report::write(preset, &reproduced, &device.device, &out)?;
    out!("{}", table_1::to_text(&systems));
    out!("report: {}", out.join("report.html").display());
    note!("reproduce: done in {:.0} s", started.elapsed().as_secs_f64());
    print_json(json, &results)
}

/// Runs the stages in order. Each uses the results of those before it.
fn run_stages(
    config: ExperimentConfig,
    out: &Path,
    device: &Opened,
    stop: &Stop,
) -> Result<ExperimentResults> {
    let mut stages = Stages::new(&config, out, device, stop);
    let datasets = stages.generate_datasets()?;
    let trained = stages.train_networks(&datasets)?;
    let published = stages.publish_networks(&trained)?;
    let systems = stages.run_sessions(&published)?;
    let stages = stages.finish();
    let datasets = datasets.into_values().map(|(_, generated)| generated).collect();
    Ok(ExperimentResults { config, device: device.name.clone(), stages, datasets, trained, systems })
}
