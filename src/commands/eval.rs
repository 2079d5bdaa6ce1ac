//! `flowservo eval`: runs servo sessions and computes Table 1.

use crate::cli;
use crate::config::Config;
use crate::device::{self, Opened};
use crate::file::write_file;
use crate::output::{out, print_json};
use crate::progress::Progress;
use crate::stop::Stop;
use anyhow::{Context, Result};
use burn::prelude::Device;
use eval::policy::oracle::Oracle;
use eval::results::system::System;
use eval::results::{metrics, table_1};
use eval::{ApproachFactory, AvoidFactory, EvalConfig, Policies, SessionRecord, run_sessions};
use std::path::Path;
use train::{ApproachModel, AvoidModel};
use world::Environment;

/// Name of the file with the records of all sessions.
pub(crate) const SESSIONS: &str = "sessions.json";

/// Name of the policies that return ground truth.
pub(crate) const ORACLE: &str = "oracle";

/// Runs the command.
pub(crate) fn run(arguments: &cli::Eval, stop: &Stop, json: bool) -> Result<()> {
    let file = Config::load(&arguments.config.config, &arguments.config.overrides)?;
    let mut config: EvalConfig = file.parse()?;
    let cli::Eval { approach, avoid, registry, .. } = arguments;
    for (policy, given) in [(&mut config.policies.approach, approach), (&mut config.policies.avoid, avoid)] {
        if let Some(given) = given {
            policy.clone_from(given);
        }
        if policy != ORACLE {
            *policy = super::lookup::checkpoint(policy, &registry.registry)?.display().to_string();
        }
    }
    file.check(config.validate())?;
    let device = device::open(arguments.device)?;
    let records = evaluate("servo sessions", &config, &device, stop)?;
    write(&arguments.out, &config, &records)?;
    let system = System::of("flowservo", &records);
    write_tables(&arguments.out, std::slice::from_ref(&system))?;
    out!("{}", table_1::to_text(std::slice::from_ref(&system)));
    print_json(json, &metrics::to_json(&system))
}

/// Runs an evaluation. Its policies are checkpoint folders or `oracle`.
pub(crate) fn evaluate(
    name: &str,
    config: &EvalConfig,
    device: &Opened,
    stop: &Stop,
) -> Result<Vec<SessionRecord>> {
    let environment = Environment::new(&config.world)?;
    let approach = approach(config, &device.device)?;
    let avoid = avoid(config, &device.device)?;
    let policies = Policies { approach: approach.as_ref(), avoid: avoid.as_ref() };
    let progress = Progress::start(name, "sessions", config.sessions as u64);
    let finished = |_: &SessionRecord| progress.advance();
    let records = run_sessions(&environment, config, policies, &finished, stop.flag())?;
    progress.finish();
    Ok(records)
}

fn approach(config: &EvalConfig, device: &Device) -> Result<Box<dyn ApproachFactory>> {
    if config.policies.approach == ORACLE {
        return Ok(Box::new(Oracle));
    }
    let model = ApproachModel::load(Path::new(&config.policies.approach), device)?;
    model.require_camera(&config.world.camera)?;
    Ok(Box::new(model))
}

fn avoid(config: &EvalConfig, device: &Device) -> Result<Box<dyn AvoidFactory>> {
    if config.policies.avoid == ORACLE {
        return Ok(Box::new(Oracle));
    }
    let model = AvoidModel::load(Path::new(&config.policies.avoid), device)?;
    model.require_camera(&config.world.camera)?;
    Ok(Box::new(model))
}

/// Writes the configuration used and the records of the sessions.
pub(crate) fn write(out: &Path, config: &EvalConfig, records: &[SessionRecord]) -> Result<()> {
    write_file(&out.join("config.toml"), toml::to_string(config)?)?;
    write_file(&out.join(SESSIONS), serde_json::to_vec(records)?)
}

/// Reads the records of the sessions.
pub(crate) fn read(out: &Path) -> Result<Vec<SessionRecord>> {
    let path = out.join(SESSIONS);
    let text = std::fs::read(&path).with_context(|| path.display().to_string())?;
    serde_json::from_slice(&text).with_context(|| path.display().to_string())
}

/// Writes Table 1 and the additional tables as text, Markdown, CSV and JSON.
pub(crate) fn write_tables(out: &Path, systems: &[System]) -> Result<()> {
    write_file(&out.join("table1.txt"), table_1::to_text(systems))?;
    write_file(&out.join("table1.md"), table_1::to_markdown(systems))?;
    write_file(&out.join("table1.csv"), metrics::to_csv(systems))?;
    write_file(&out.join("table1.json"), serde_json::to_string_pretty(&metrics::all_to_json(systems))?)
}
