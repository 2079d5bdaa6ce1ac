//! What can be wrong with a file in a dataset's folder.

use crate::error::{Error, Result};
use crate::info::FileRecord;
use crate::publish::digest_of_file;
use std::fmt;
use std::io::ErrorKind;
use std::path::Path;

/// A file that is not as it should be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// Path below the dataset's folder, with `/`.
    pub path: String,
    /// What is wrong with it.
    pub problem: Problem,
}

/// What is wrong with a file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// It is not there.
    #[error("missing")]
    Missing,
    /// It is there, but nothing says what its digest should be: it was not finished, or was copied without `shards/`.
    #[error("there without its record in shards/")]
    Unrecorded,
    /// It was cut short, or something was added.
    #[error("expected {expected} bytes, found {found}")]
    Size {
        /// Bytes it should have.
        expected: u64,
        /// Bytes it has.
        found: u64,
    },
    /// It has changed.
    #[error("expected SHA-256 {expected}, found {found}")]
    Digest {
        /// Digest it should have.
        expected: String,
        /// Digest it has.
        found: String,
    },
    /// A description that is not as flowservo wrote it.
    #[error("expected {expected}, found {found}")]
    Form {
        /// What should be there.
        expected: String,
        /// What is there.
        found: String,
    },
    /// The system does not let it be read.
    #[error("cannot be read: {0}")]
    Unreadable(String),
    /// It was made with another configuration.
    #[error("of another configuration (digest {0}); remove it and its record in shards/")]
    OtherConfig(String),
    /// It was made by another version of flowservo.
    #[error("made by flowservo {0}; remove it and its record in shards/, or finish with that version")]
    OtherVersion(String),
    /// It is none of the dataset's, but data tools would read it, too.
    #[error("does not belong to this dataset")]
    Stray,
}

impl Problem {
    /// What is wrong with a file that should have this digest.
    pub(crate) fn of_digest(path: &Path, expected: &str) -> Option<Self> {
        match digest_of_file(path) {
            Ok(found) if found == *expected => None,
            Ok(found) => Some(Self::Digest { expected: expected.to_owned(), found }),
            Err(Error::Io { source, .. }) => Some(Self::of_io(&source)),
            Err(error) => Some(Self::Unreadable(error.to_string())),
        }
    }

    /// What is wrong with the size of a file.
    pub(crate) fn of_size(path: &Path, expected: u64) -> Option<Self> {
        match std::fs::metadata(path) {
            Ok(found) if found.len() == expected => None,
            Ok(found) => Some(Self::Size { expected, found: found.len() }),
            Err(error) => Some(Self::of_io(&error)),
        }
    }

    fn of_io(error: &std::io::Error) -> Self {
        if error.kind() == ErrorKind::NotFound { Self::Missing } else { Self::Unreadable(error.to_string()) }
    }
}

impl FileRecord {
    /// What is wrong with the file, if anything; reads it.
    pub(crate) fn problem(&self, dir: &Path) -> Option<Problem> {
        let path = dir.join(&self.path);
        Problem::of_size(&path, self.bytes).or_else(|| Problem::of_digest(&path, &self.sha256))
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{}: {}", self.path, self.problem)
    }
}

/// An error that lists the faults of a dataset, if there are any.
pub fn none(dir: &Path, faults: Vec<Fault>) -> Result<()> {
    if faults.is_empty() { Ok(()) } else { Err(Error::Changed { dir: dir.to_owned(), faults }) }
}

/// A line each, indented.
pub(crate) fn lines<T: fmt::Display>(items: impl IntoIterator<Item = T>) -> String {
    items.into_iter().fold(String::new(), |text, item| text + &format!("\n  {item}"))
}
