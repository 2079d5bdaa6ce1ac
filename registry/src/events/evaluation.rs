//! Evaluations: how good a version is, measured after publication.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::error::{Error, Result};
use crate::model::ModelVersion;

/// Metrics of a version and the configuration of their measurement: a JSON document that is attached to the version.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Name, ending in its unit, and finite value.
    pub metrics: BTreeMap<String, f64>,
    /// Configuration of the measurement, in the evaluator's words: enough to repeat it.
    pub configuration: BTreeMap<String, Value>,
}

/// One metric of a version.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Metric {
    /// The value.
    pub value: f64,
    /// Number of the event that attached the evaluation. `None` if the value is from the version's own manifest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attachment: Option<u64>,
}

impl Evaluation {
    /// Refuses an empty evaluation, and values that JSON cannot represent.
    pub(crate) fn check(&self, version: &ModelVersion) -> Result<()> {
        if self.metrics.is_empty() {
            return Err(Error::refused(version, "the evaluation has no metrics"));
        }
        check_finite(&self.metrics)
    }
}

/// Refuses values that JSON cannot represent.
pub(crate) fn check_finite(metrics: &BTreeMap<String, f64>) -> Result<()> {
    match metrics.iter().find(|(_, value)| !value.is_finite()) {
        Some((name, value)) => Err(Error::refused(
            &format!("metric `{name}`"),
            format!("it is {value}; only finite numbers can be published"),
        )),
        None => Ok(()),
    }
}
