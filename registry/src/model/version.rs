//! One published version of a model.

use std::fmt;

use serde::Serialize;

use super::event::{Note, Target};
use super::manifest::Manifest;
use super::reference::ModelName;
use crate::digest::Digest;

/// A published version, with its manifest verified.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub struct ModelVersion {
    /// The model.
    pub name: ModelName,
    /// Number of the version, from 1.
    pub version: u64,
    /// Digest of the manifest. It identifies the version as `NAME@sha256:...` in any registry.
    pub digest: Digest,
    /// Files, lineage and metrics.
    pub manifest: Manifest,
    /// The note of the yank, if the version is yanked. Callers should warn the user.
    pub yanked: Option<Note>,
}

impl ModelVersion {
    /// Creates a version that is not yanked.
    pub(crate) fn new(name: &ModelName, version: u64, digest: Digest, manifest: Manifest) -> Self {
        Self { name: name.clone(), version, digest, manifest, yanked: None }
    }

    /// Returns what events record of this version.
    pub(crate) fn target(&self) -> Target {
        Target { version: self.version, digest: self.digest }
    }
}

impl fmt::Display for ModelVersion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", self.name, self.version)
    }
}
