//! `flowservo eval`: servo sessions, and Table 1 of what comes out.

use super::{print_json, write_file};
use crate::cli;
use crate::config::Config;
use crate::device::{self, Opened};
use crate::output::out;
use crate::progress::Progress;
use crate::stop::Stop;
use anyhow::{Context, Result};
use burn::prelude::Device;
use eval::config::EvalConfig;
use eval::measures::{self, System};
use eval::oracle::{ApproachOracle, AvoidOracle};
use eval::policy::{ApproachPolicy, AvoidPolicy, Policies};
use eval::trace::SessionRecord;
use eval::{run_sessions, tables};
use std::path::Path;
use train::{ApproachModel, AvoidModel};
use world::Environment;

/// Name of the file with all sessions, step by step.
pub(crate) const SESSIONS: &str = "sessions.json";

/// Runs the command.
pub(crate) fn run(arguments: &cli::Eval, stop: &Stop, json: bool) -> Result<()> {
    let file = Config::load(&arguments.config.config, &arguments.config.overrides)?;
    let mut config: EvalConfig = file.parse()?;
    let cli::Eval { approach, avoid, registry, .. } = arguments;
    for (place, given) in [(&mut config.policies.approach, approach), (&mut config.policies.avoid, avoid)] {
        if let Some(given) = given {
            place.clone_from(given);
        }
        if place != ORACLE {
            *place = super::model::checkpoint(place, &registry.registry)?.display().to_string();
        }
    }
    file.check(config.validate())?;
    let device = device::open(arguments.device)?;
    let records = evaluate("servo sessions", &config, &device, stop)?;
    write(&arguments.out, &config, &records)?;
    let system = System::of("flowservo", &records);
    write_tables(&arguments.out, std::slice::from_ref(&system))?;
    out!("{}", tables::to_text(std::slice::from_ref(&system)));
    print_json(json, &measures::to_json(&system))
}

/// Ground truth in the place of a network.
pub(crate) const ORACLE: &str = "oracle";

/// Runs the sessions of a configuration whose policies are folders of checkpoints, or `oracle`.
pub(crate) fn evaluate(
    name: &str,
    config: &EvalConfig,
    device: &Opened,
    stop: &Stop,
) -> Result<Vec<SessionRecord>> {
    let environment = Environment::new(&config.world)?;
    let approach = approach(config, &device.device)?;
    let avoid = avoid(config, &environment, &device.device)?;
    let policies = Policies { approach: approach.as_ref(), avoid: avoid.as_ref() };
    let progress = Progress::start(name, "sessions", config.sessions as u64);
    let finished = |_: &SessionRecord| progress.advance();
    let records = run_sessions(&environment, config, policies, &finished, stop.flag())?;
    progress.finish();
    Ok(records)
}

fn approach(config: &EvalConfig, device: &Device) -> Result<Box<dyn ApproachPolicy>> {
    if config.policies.approach == ORACLE {
        return Ok(Box::new(ApproachOracle));
    }
    let model = ApproachModel::load(Path::new(&config.policies.approach), device)?;
    model.require_camera(&config.world.camera)?;
    Ok(Box::new(model))
}

fn avoid<'a>(
    config: &EvalConfig,
    environment: &'a Environment,
    device: &Device,
) -> Result<Box<dyn AvoidPolicy + 'a>> {
    if config.policies.avoid == ORACLE {
        return Ok(Box::new(AvoidOracle { environment }));
    }
    let model = AvoidModel::load(Path::new(&config.policies.avoid), device)?;
    model.require_camera(&config.world.camera)?;
    Ok(Box::new(model))
}

/// Writes the configuration that was used, and the sessions.
pub(crate) fn write(out: &Path, config: &EvalConfig, records: &[SessionRecord]) -> Result<()> {
    write_file(&out.join("config.toml"), toml::to_string(config)?)?;
    write_file(&out.join(SESSIONS), serde_json::to_vec(records)?)
}

/// Reads the sessions back.
pub(crate) fn read(out: &Path) -> Result<Vec<SessionRecord>> {
    let path = out.join(SESSIONS);
    let text = std::fs::read(&path).with_context(|| path.display().to_string())?;
    serde_json::from_slice(&text).with_context(|| path.display().to_string())
}

/// Writes Table 1 and what goes with it as text, Markdown, CSV and JSON.
pub(crate) fn write_tables(out: &Path, systems: &[System]) -> Result<()> {
    write_file(&out.join("table1.txt"), tables::to_text(systems))?;
    write_file(&out.join("table1.md"), tables::to_markdown(systems))?;
    write_file(&out.join("table1.csv"), measures::to_csv(systems))?;
    write_file(&out.join("table1.json"), serde_json::to_string_pretty(&measures::all_to_json(systems))?)
}
