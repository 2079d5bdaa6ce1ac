//! `flowservo model attach`: evaluations and signatures of published versions.

use super::alias::note;
use crate::cli::{Attach, NoteArgs};
use crate::commands::eval;
use crate::commands::lookup::{reference, warn};
use crate::error::bad_input;
use crate::output::{out, print_json};
use ::eval::EvalConfig;
use ::eval::results::metrics;
use ::eval::results::system::System;
use anyhow::{Context, Result, anyhow};
use registry::{Attachment, Evaluation, Event, ModelVersion, Outcome, Registry, Signature};
use serde_json::{Value, json};
use std::path::Path;
use train::checkpoint::{ModelInfo, WEIGHTS};

/// Runs the command.
pub(crate) fn run(arguments: &Attach, json: bool) -> Result<()> {
    let registry = Registry::open(&arguments.registry.registry)?;
    let version = registry.show(&reference(&arguments.model)?)?;
    warn(&version);
    let attachment = match (&arguments.evaluation, &arguments.signature) {
        (Some(folder), _) => {
            let weights = version.manifest.layers.iter().find(|layer| layer.path() == Some(WEIGHTS));
            let weights = weights.map(|layer| layer.digest.hex()).unwrap_or_default();
            Attachment::Evaluation(evaluation(&weights, folder)?)
        }
        (None, Some(file)) => Attachment::Signature(read_signature(file)?),
        (None, None) => unreachable!("the command line requires one of the two"),
    };
    let attached = attach(&registry, &version, &attachment, &arguments.note)?;
    print_json(json, &json!({ "changed": attached.is_new(), "attachment": attached.value() }))
}

/// Attaches something to a version, and reports it.
pub(crate) fn attach(
    registry: &Registry,
    version: &ModelVersion,
    attachment: &Attachment,
    notes: &NoteArgs,
) -> Result<Outcome<Event>> {
    let what = match attachment {
        Attachment::Signature(_) => "signature",
        _ => "evaluation",
    };
    let attached = registry.attach(version, attachment, &note(notes))?;
    let number = attached.value().number;
    match &attached {
        Outcome::New(_) => out!("{version}: {what} attached (attachment {number})"),
        Outcome::AlreadyThere(_) => {
            out!("{version} already has this {what} (attachment {number}); nothing was attached");
        }
    }
    Ok(attached)
}

/// Reads a signature from a file.
pub(crate) fn read_signature(file: &Path) -> Result<Signature> {
    let content = std::fs::read(file).with_context(|| file.display().to_string()).map_err(bad_input)?;
    Signature::parse(&content).with_context(|| file.display().to_string())
}

/// Attaches an evaluation, unless the version already has all its metrics.
pub(crate) fn attach_new_metrics(
    registry: &Registry,
    version: &ModelVersion,
    evaluation: Evaluation,
) -> Result<()> {
    let known = registry.metrics(version)?;
    let is_known = |(name, value): (&String, &f64)| {
        known.get(name).is_some_and(|known| known.value.to_bits() == value.to_bits())
    };
    if evaluation.metrics.iter().all(is_known) {
        out!("{version} already has these metrics; nothing was attached");
        return Ok(());
    }
    attach(registry, version, &Attachment::Evaluation(evaluation), &NoteArgs::default()).map(drop)
}

/// Summarizes the servo sessions in `folder` for a checkpoint, see [`evaluation`].
pub(crate) fn evaluation_of(checkpoint: &Path, folder: &Path) -> Result<Evaluation> {
    evaluation(&ModelInfo::read(checkpoint)?.weights_sha256, folder)
}

/// Summarizes the servo sessions in `folder` for the network whose weights have this SHA-256: the figures of Table 1, prefixed with
/// `table1_`. Times are omitted because they depend on the machine.
///
/// The configuration names the networks by the digests of their weights, which are the same everywhere.
fn evaluation(weights: &str, folder: &Path) -> Result<Evaluation> {
    measured(weights, folder).map_err(bad_input)
}

fn measured(weights: &str, folder: &Path) -> Result<Evaluation> {
    let path = folder.join("config.toml");
    let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    let mut config: EvalConfig = toml::from_str(&text).with_context(|| path.display().to_string())?;
    let policies = config.policies.clone();
    let mut is_of_these = false;
    for policy in [&mut config.policies.approach, &mut config.policies.avoid] {
        if let Ok(used) = ModelInfo::read(Path::new(policy.as_str())) {
            is_of_these |= used.weights_sha256 == weights;
            *policy = format!("sha256:{}", used.weights_sha256);
        }
    }
    if !is_of_these {
        let (place, approach, avoid) = (path.display(), policies.approach, policies.avoid);
        return Err(anyhow!(
            "the sessions did not use this network: {place} has policies.approach = \"{approach}\" and policies.avoid = \
             \"{avoid}\", which do not exist or have other weights"
        ));
    }
    let figures = metrics::to_json(&System::of("flowservo", &eval::read(folder)?));
    let numbers = figures.as_object().into_iter().flatten();
    let metrics =
        numbers.filter_map(|(key, value)| Some((format!("table1_{key}"), value.as_f64()?))).collect();
    let Value::Object(configuration) = serde_json::to_value(&config)? else {
        unreachable!("a structure with named fields")
    };
    Ok(Evaluation { metrics, configuration: configuration.into_iter().collect() })
}
