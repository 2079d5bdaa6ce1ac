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
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub previous: Option<Digest>,
    /// What happened.
    #[serde(flatten)]
    pub kind: EventKind,
    /// Who recorded it, when and why.
    #[serde(flatten)]
    pub note: Note,
}

/// What happened.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
#[non_exhaustive]
pub enum EventKind {
    /// The alias names this version from now on.
    AliasSet {
        /// The version.
        target: Target,
    },
    /// The alias names no version from now on.
    AliasRemoved,
    /// The version was yanked.
    Yanked {
        /// The version.
        target: Target,
    },
    /// The version is no longer yanked.
    Unyanked {
        /// The version.
        target: Target,
    },
    /// Something was attached to the version.
    Attached {
        /// The version.
        target: Target,
        /// The attached blob.
        attached: Descriptor,
    },
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
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub who: Option<String>,
    /// Why.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// When, in RFC 3339 (`2026-11-22T10:00:00Z`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub when: Option<String>,
}

impl Event {
    /// Returns the version that the event refers to. Only the end of an alias refers to none.
    pub fn target(&self) -> Option<Target> {
        match self.kind {
            EventKind::AliasRemoved => None,
            EventKind::AliasSet { target }
            | EventKind::Yanked { target }
            | EventKind::Unyanked { target }
            | EventKind::Attached { target, .. } => Some(target),
        }
    }

    /// Returns the attached blob, if the event attaches one.
    pub fn attached(&self) -> Option<&Descriptor> {
        match &self.kind {
            EventKind::Attached { attached, .. } => Some(attached),
            _ => None,
        }
    }
}
