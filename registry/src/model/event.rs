//! Events: what happened to a version or an alias after publication.

use serde::{Deserialize, Serialize};

use super::manifest::Descriptor;
use crate::digest::Digest;

/// One event in the log of an alias or a version.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Event {
    /// The alias (`approach:champion`) or version (`approach@3`).
    pub subject: String,
    /// Number of the event, from 1.
    pub number: u64,
    /// Digest of the previous event. The first one has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub previous: Option<Digest>,
    /// Digest of the event itself, known when it is stored.
    #[serde(skip)]
    pub digest: Option<Digest>,
    /// What happened.
    #[serde(rename = "event")]
    pub kind: EventKind,
    /// The version that the event refers to. Only the end of an alias refers to none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<Target>,
    /// The attached blob, if the event attaches one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub attached: Option<Descriptor>,
    /// Who recorded it, when and why.
    #[serde(flatten)]
    pub note: Note,
}

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum EventKind {
    /// The alias names this version from now on.
    AliasSet,
    /// The alias names no version from now on.
    AliasRemoved,
    /// The version was yanked.
    Yanked,
    /// The version is no longer yanked.
    Unyanked,
    /// Something was attached to the version.
    Attached,
}

/// The version that an event refers to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Target {
    /// Its number.
    pub version: u64,
    /// Digest of its manifest.
    pub digest: Digest,
}

/// Author, reason and time of an event, as its author states them.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Note {
    /// Who recorded it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
    /// Why.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// When, in RFC 3339 (`2026-11-22T10:00:00Z`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub when: Option<String>,
}
