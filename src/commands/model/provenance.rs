//! The provenance that is published with a checkpoint: lineage, metrics, and the interface of the network.

use crate::clock;
use anyhow::{Context, Result};
use registry::{Digest, Lineage, Provenance};
use std::collections::BTreeMap;
use std::path::Path;
use train::checkpoint::{ModelInfo, WEIGHTS};
use train::{Description, Metrics, Task};

/// Collects the provenance of a checkpoint, with the current time as its time of publication.
pub(crate) fn of(checkpoint: &Path) -> Result<Provenance> {
    let info = ModelInfo::read(checkpoint)
        .with_context(|| format!("{} is not a checkpoint folder", checkpoint.display()))?;
    let metrics = info.epoch.as_ref().map(|epoch| validation(&epoch.validation)).unwrap_or_default();
    let serde_json::Value::Object(described) = serde_json::to_value(Description::complete(checkpoint)?)?
    else {
        unreachable!("a structure with named fields")
    };
    let purpose = match info.task {
        Task::Approach { .. } => {
            "CNN_approach: from the current and the goal image to the hand motion that turns one into the other"
        }
        Task::Avoidance { .. } => "CNN_avoid: from the current image to the risk of each direction of motion",
    };
    let published = ["camera", "input", "output"];
    let mut interface: BTreeMap<_, _> =
        described.into_iter().filter(|(key, _)| published.contains(&key.as_str())).collect();
    interface.insert("purpose".to_owned(), purpose.into());
    let weights = format!("sha256:{}", info.weights_sha256).parse()?;
    let expected = BTreeMap::from([(WEIGHTS.to_owned(), weights)]);
    let created = Some(clock::rfc3339(clock::now()));
    Ok(Provenance { lineage: lineage(&info, checkpoint)?, metrics, interface, created, expected })
}

/// Returns the inputs from which the checkpoint was trained.
fn lineage(info: &ModelInfo, checkpoint: &Path) -> Result<Lineage> {
    let mut datasets = BTreeMap::new();
    for source in &info.datasets {
        datasets.insert(source.name.clone(), format!("sha256:{}", source.digest).parse()?);
    }
    let config = std::fs::read(checkpoint.join("config.toml"))?;
    let parent = info.parent.as_ref().and_then(|parent| parent.version.as_ref());
    let parent = parent.map(|version| format!("sha256:{}", version.manifest_sha256).parse()).transpose()?;
    let program = info.program.clone();
    Ok(Lineage {
        datasets,
        config: Some(Digest::of(&config)),
        parent,
        code_revision: program.as_ref().and_then(|program| program.code_revision.clone()),
        seed: Some(info.seed),
        device: info.device.clone(),
        software: program.map(|program| program.software).unwrap_or_default(),
    })
}

/// Returns the metrics on the validation set.
fn validation(metrics: &Metrics) -> BTreeMap<String, f64> {
    let named = match metrics {
        Metrics::Approach(m) => [
            ("validation_loss", m.loss),
            ("validation_position_error_mm", m.position_error_mm),
            ("validation_orientation_error_deg", m.orientation_error_deg),
        ],
        Metrics::Avoidance(m) => [
            ("validation_loss", m.loss),
            ("validation_rms_error", m.rms_error),
            ("validation_skill", m.skill),
        ],
    };
    named.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}
