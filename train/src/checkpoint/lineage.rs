//! The origin of a model: the program that trained it, and the model that it was trained from.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// The training program.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Program {
    /// Revision of its code, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub code_revision: Option<String>,
    /// Versions of the program and of its components, by name.
    pub software: BTreeMap<String, String>,
}

/// The model that a training run started from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Parent {
    /// SHA-256 of its weights.
    pub weights_sha256: String,
    /// Its version in a registry, if it came from one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub version: Option<Version>,
}

/// A published version of a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Version {
    /// Name and number, as `approach@3`.
    pub name: String,
    /// SHA-256 of its manifest.
    pub manifest_sha256: String,
}

/// Origin of the initial weights. Both are `None` if they are random.
#[derive(Default)]
pub(crate) struct InitialWeights {
    /// SHA-256 of the file of published weights.
    pub(crate) pretrained_sha256: Option<String>,
    pub(crate) parent: Option<Parent>,
}
