//! `flowservo model attach`: what is said of a version after it was published.

use super::eval;
use super::model::{reference, warn};
use super::model_alias::remark;
use crate::cli::{Attach, RemarkArgs};
use crate::error::bad_input;
use crate::output::{out, print_json};
use ::eval::EvalConfig;
use ::eval::results::metrics;
use ::eval::results::system::System;
use anyhow::{Context, Result, anyhow};
use registry::{Attached, Attachment, Evaluation, ModelVersion, Registry, Signature};
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
        (None, None) => unreachable!("the command line demands one of the two"),
    };
    let attached = attach(&registry, &version, &attachment, &arguments.remark)?;
    let changed = matches!(attached, Attached::New(_));
    print_json(json, &json!({ "changed": changed, "attachment": attached.entry() }))
}

/// Attaches something to a version, and says so.
pub(crate) fn attach(
    registry: &Registry,
    version: &ModelVersion,
    attachment: &Attachment,
    remarks: &RemarkArgs,
) -> Result<Attached> {
    let what = match attachment {
        Attachment::Signature(_) => "signature",
        _ => "evaluation",
    };
    let attached = registry.attach(version, attachment, &remark(remarks))?;
    let number = attached.entry().number;
    match &attached {
        Attached::New(_) => out!("{version}: {what} attached (attachment {number})"),
        Attached::AlreadyThere(_) => {
            out!("{version} has this {what} already (attachment {number}); nothing was attached");
        }
    }
    Ok(attached)
}

/// Reads a signature from a file.
pub(crate) fn read_signature(file: &Path) -> Result<Signature> {
    let content = std::fs::read(file).with_context(|| file.display().to_string()).map_err(bad_input)?;
    Signature::parse(&content).with_context(|| file.display().to_string())
}

/// Attaches an evaluation, unless all that it measured is known of the version.
pub(crate) fn attach_news(registry: &Registry, version: &ModelVersion, evaluation: Evaluation) -> Result<()> {
    let known = registry.metrics(version)?;
    let is_known = |(name, value): (&String, &f64)| {
        known.get(name).is_some_and(|known| known.value.to_bits() == value.to_bits())
    };
    if evaluation.metrics.iter().all(is_known) {
        out!("{version} has these metrics already; nothing was attached");
        return Ok(());
    }
    attach(registry, version, &Attachment::Evaluation(evaluation), &RemarkArgs::default()).map(drop)
}

/// What the servo sessions in `folder` say about a checkpoint, see [`evaluation`].
pub(crate) fn evaluation_of(checkpoint: &Path, folder: &Path) -> Result<Evaluation> {
    evaluation(&ModelInfo::read(checkpoint)?.weights_sha256, folder)
}

/// What the servo sessions in `folder` say about the network whose weights have this SHA-256: Table 1's figures under `table1_`,
/// computed anew. Times are left out: they belong to a machine.
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
            "the sessions are not of this network: {place} has policies.approach = \"{approach}\" and policies.avoid = \
             \"{avoid}\", which are not there or have other weights"
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
