//! Errors, worded for the person who can act on them.

use std::fmt::Display;
use std::path::Path;

use crate::problem::Problem;

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Why an operation was refused or failed. A failure never changes anything that was published before.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An invalid name or reference.
    #[error("`{text}` is not {expected}")]
    Invalid {
        /// The text.
        text: String,
        /// What was expected, and how it is written.
        expected: &'static str,
    },
    /// Something is not valid, or cannot be published, attached, recorded, copied, compared, imported or written.
    #[error("{subject}: {reason}")]
    Refused {
        /// The version, alias, model, metric, location, file or object.
        subject: String,
        /// What is wrong with it and what to do.
        reason: String,
    },
    /// There is no registry at this location.
    #[error("there is no registry at `{0}` (create one with `model init`)")]
    NoRegistry(String),
    /// There is no such model, version, alias or signature. The message lists what there is.
    #[error("{0}")]
    NotFound(String),
    /// A precondition does not hold.
    #[error("{0}; nothing was changed")]
    Conflict(String),
    /// The registry is damaged: an object is not what was published.
    #[error("{0}{remedy}", remedy = .0.fault.remedy())]
    Damaged(Box<Problem>),
    /// A file, a folder or an object could not be read or written.
    #[error("{place}: cannot {action}: {source}")]
    Failed {
        /// The attempted action.
        action: &'static str,
        /// The file or folder, or the location of the registry and the key of the object in it.
        place: String,
        /// The answer of the system or the store.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

impl Error {
    /// Wraps a failed operation on a local file or folder, for `map_err`.
    pub(crate) fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        move |source| Self::Failed { action, place: path.display().to_string(), source: source.into() }
    }

    /// Refuses something about `subject`.
    pub(crate) fn refused(subject: &dyn Display, reason: impl Into<String>) -> Self {
        Self::Refused { subject: subject.to_string(), reason: reason.into() }
    }
}

impl From<Problem> for Error {
    fn from(problem: Problem) -> Self {
        Self::Damaged(Box::new(problem))
    }
}
