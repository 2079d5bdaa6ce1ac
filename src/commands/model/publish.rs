//! `flowservo model publish`: a checkpoint as the next version of a model.

use super::lookup::warn;
use super::{attach, provenance};
use crate::error::bad_input;
use crate::output::out;
use anyhow::Result;
use registry::{ModelName, ModelVersion, Outcome, Registry};
use std::path::Path;

/// Publishes a checkpoint as the next version of a name. If the version exists, the evaluation is attached to it.
pub(crate) fn publish(
    registry: &Registry,
    checkpoint: &Path,
    name: &str,
    evaluation: Option<&Path>,
) -> Result<Outcome<ModelVersion>> {
    let name: ModelName = name.parse().map_err(bad_input)?;
    let mut provenance = provenance::of(checkpoint)?;
    let evaluation = evaluation.map(|folder| attach::evaluation_of(checkpoint, folder)).transpose()?;
    if let Some(evaluation) = &evaluation {
        provenance.metrics.extend(evaluation.metrics.clone());
    }
    let published = registry.publish(&name, checkpoint, provenance)?;
    warn(published.value());
    let ModelVersion { name, version, .. } = published.value();
    match &published {
        Outcome::New(_) => out!("published {name}@{version}"),
        Outcome::AlreadyThere(_) => {
            out!("{name}@{version} already has this content; nothing was published");
            if let Some(evaluation) = evaluation {
                attach::attach_new_metrics(registry, published.value(), evaluation)?;
            }
        }
    }
    Ok(published)
}
