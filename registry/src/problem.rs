//! Damage to a registry: what `verify` reports, and why other operations refuse.

use std::fmt;

use serde::Serialize;

use crate::digest::{Digest, Fingerprint};

/// One object of the registry that is not what was published.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// What the problem affects: a version (`approach@3`), its events (`approach@3/events`) or an alias
    /// (`approach:champion`). `None` if it affects none of them.
    pub model: Option<String>,
    /// The affected file of the checkpoint. `None` for a manifest, a model configuration or an event.
    pub file: Option<String>,
    /// Key of the object below the registry's root.
    pub object: String,
    /// What is wrong.
    #[serde(flatten)]
    pub fault: Fault,
}

/// What is wrong with one object.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, thiserror::Error)]
#[serde(tag = "fault", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Fault {
    /// The object is missing.
    #[error("is missing")]
    Missing,
    /// The object has the wrong size.
    #[error("has {found} bytes, expected {expected}")]
    Size {
        /// Size that the manifest states.
        expected: u64,
        /// Size of the object.
        found: u64,
    },
    /// The object has the wrong content.
    #[error("has digest {found}, expected {expected}")]
    Digest {
        /// Digest that the object must have.
        expected: Digest,
        /// Digest of the object.
        found: Digest,
    },
    /// A numbered pointer names a blob that does not exist.
    #[error(
        "names {digest}, which is not among the blobs: either this pointer was altered, or the blob is lost"
    )]
    Dangling {
        /// Digest that the pointer names.
        digest: Digest,
    },
    /// The object cannot be understood, or is in the wrong place.
    #[error("is not what belongs here: {reason}")]
    Malformed {
        /// What is wrong with it.
        reason: String,
    },
    /// The store could not read the object.
    #[error("cannot be read: {reason}")]
    Unreadable {
        /// The store's answer.
        reason: String,
    },
    /// The object, or a folder on the way to it, is a symbolic link, a named pipe, a socket or a device.
    #[error(
        "is a symbolic link or a special file, which a registry does not follow: replace it with what it points to, or remove it"
    )]
    Irregular,
    /// The object has no place in a registry.
    #[error("does not belong in a registry: remove it")]
    Stray,
}

impl Fault {
    /// Returns advice, where the fault's own message has none.
    pub(crate) fn remedy(&self) -> &'static str {
        match self {
            Self::Irregular | Self::Stray => "",
            _ => "; restore the registry from a backup, or publish the checkpoint again",
        }
    }

    /// Compares the content of a blob with the expected one.
    pub(crate) fn of_blob(expected: Fingerprint, found: Option<Fingerprint>) -> Option<Self> {
        match found {
            None => Some(Self::Missing),
            Some(found) if found.size != expected.size => {
                Some(Self::Size { expected: expected.size, found: found.size })
            }
            Some(found) if found.digest != expected.digest => {
                Some(Self::Digest { expected: expected.digest, found: found.digest })
            }
            Some(_) => None,
        }
    }

    /// Attributes the fault to the object `key`, which belongs to `model`, or to none if that is empty.
    pub(crate) fn of(self, model: &str, key: &str) -> Problem {
        let model = (!model.is_empty()).then(|| model.to_owned());
        Problem { model, file: None, object: key.to_owned(), fault: self }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(model) = &self.model {
            write!(f, "{model}: ")?;
        }
        match &self.file {
            Some(file) => write!(f, "{file} ({}) {}", self.object, self.fault),
            None => write!(f, "{} {}", self.object, self.fault),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_well_and_serializes() {
        let problem = Problem {
            model: Some("approach@3".into()),
            file: Some("weights.safetensors".into()),
            object: "blobs/sha256/ab/ab".into(),
            fault: Fault::Size { expected: 12, found: 11 },
        };
        let message = "approach@3: weights.safetensors (blobs/sha256/ab/ab) has 11 bytes, expected 12";
        assert_eq!(problem.to_string(), message);
        let json = r#"{"model":"approach@3","file":"weights.safetensors","object":"blobs/sha256/ab/ab","fault":"size","expected":12,"found":11}"#;
        assert_eq!(serde_json::to_string(&problem).unwrap(), json);
    }
}
