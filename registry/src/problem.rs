//! What is wrong with a published version, an alias, a yank or an attachment: found by `verify`, and the reason why `pull` refuses.

use std::fmt;

use serde::Serialize;

use crate::digest::{Digest, Fingerprint};

/// One object of the registry that is not what was published.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// What it spoils, `approach@3`, `approach:champion` or `approach@3/attachments`; `None` where the object belongs to none.
    pub model: Option<String>,
    /// The checkpoint's file that it spoils; `None` where it is the manifest or the configuration.
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
    /// The object is not there.
    #[error("is missing")]
    Missing,
    /// The object has another size than the manifest says.
    #[error("has {found} bytes, expected {expected}")]
    Size {
        /// Bytes that the manifest states.
        expected: u64,
        /// Bytes that are there.
        found: u64,
    },
    /// The object has another content than the manifest says.
    #[error("has digest {found}, expected {expected}")]
    Digest {
        /// Digest that the manifest states.
        expected: Digest,
        /// Digest of what is there.
        found: Digest,
    },
    /// The manifest or entry is not among the blobs: it is not the one that was published, or its blob was lost.
    #[error("was altered after publishing, or its copy among the blobs ({digest}) is lost")]
    Altered {
        /// Digest of the manifest or entry as it is now.
        digest: Digest,
    },
    /// The manifest or entry cannot be understood, or does not belong here.
    #[error("is not what belongs here: {reason}")]
    Malformed {
        /// What is wrong with it.
        reason: String,
    },
    /// The store could not read the object.
    #[error("cannot be read: {reason}")]
    Unreadable {
        /// What the store answered.
        reason: String,
    },
    /// The object, or a folder on the way to it, is a symbolic link.
    #[error(
        "is a symbolic link, and a registry follows none: put what it points to in its place, or remove it"
    )]
    Link,
    /// The object is a named pipe, a socket or a device.
    #[error("is neither a file nor a folder: remove it")]
    Special,
    /// The object has no place in a registry.
    #[error("does not belong in a registry: remove it")]
    Stray,
}

impl Fault {
    /// What to do about it, where the fault itself does not say.
    pub(crate) fn remedy(&self) -> &'static str {
        match self {
            Self::Link | Self::Special | Self::Stray => "",
            _ => "; restore the registry from a copy, or publish the checkpoint again",
        }
    }

    /// What is wrong with a blob that holds `found` where the manifest states `expected`.
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
    fn is_told_to_people_and_to_scripts() {
        let problem = Problem {
            model: Some("approach@3".into()),
            file: Some("weights.safetensors".into()),
            object: "blobs/sha256/ab/ab".into(),
            fault: Fault::Size { expected: 12, found: 11 },
        };
        let told = "approach@3: weights.safetensors (blobs/sha256/ab/ab) has 11 bytes, expected 12";
        assert_eq!(problem.to_string(), told);
        let json = r#"{"model":"approach@3","file":"weights.safetensors","object":"blobs/sha256/ab/ab","fault":"size","expected":12,"found":11}"#;
        assert_eq!(serde_json::to_string(&problem).unwrap(), json);
    }
}
