//! What can go wrong with a dataset.

use crate::rejection::Rejections;
use std::path::PathBuf;

/// An error of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value of the configuration that makes no dataset.
    #[error("{key} = {value}: expected {expected}")]
    Config {
        /// The key, with the tables it stands in.
        key: String,
        /// What it says.
        value: String,
        /// What it may say.
        expected: &'static str,
    },
    /// A configuration with a missing or unknown key, or a value of the wrong type.
    #[error("dataset configuration: {0}")]
    ConfigForm(#[from] toml::de::Error),
    /// The environment of the configuration cannot be built.
    #[error(transparent)]
    World(#[from] world::Error),
    /// Nothing acceptable was drawn within the bound.
    #[error("no acceptable scene: {0}; widen what rejects most, or raise rejection.tries")]
    Unplaceable(Rejections),
    /// An error at one example.
    #[error("example {index}: {source}")]
    Example {
        /// Its index in the dataset.
        index: u64,
        /// What went wrong.
        source: Box<Error>,
    },
    /// An image that cannot be encoded.
    #[error("cannot encode an image as PNG: {0}")]
    Png(#[from] image::ImageError),
    /// Rows that cannot be put into columns.
    #[error("cannot encode rows: {0}")]
    Encode(#[from] arrow_schema::ArrowError),
    /// A description that cannot be put into JSON.
    #[error("cannot encode as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// A file that cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        source: std::io::Error,
    },
    /// A file that is not what the dataset says it is.
    #[error("{}: expected {expected}, found {found}; generate the dataset again, or fetch it again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What should be there.
        expected: String,
        /// What is there.
        found: String,
    },
    /// A folder that holds no complete dataset.
    #[error(
        "{} holds no complete dataset: dataset.json, which is written last, is missing; run `dataset generate` with the \
         same configuration to complete it",
        dir.display()
    )]
    Incomplete {
        /// The folder.
        dir: PathBuf,
    },
    /// A folder that already holds a dataset of another configuration.
    #[error(
        "{} holds a dataset of another configuration (digest {found}, wanted {wanted}); choose another folder, or \
         remove it",
        dir.display()
    )]
    OtherConfig {
        /// The folder.
        dir: PathBuf,
        /// Digest of the configuration there.
        found: String,
        /// Digest of the configuration asked for.
        wanted: String,
    },
    /// A file among the rows that is none of the dataset's, which data tools would read, too.
    #[error("{} does not belong to this dataset; remove it, or choose another folder", path.display())]
    Stray {
        /// The file.
        path: PathBuf,
    },
    /// A dataset of the other kind than the reader needs.
    #[error("{} is a dataset of kind {found}; {expected} is needed here", dir.display())]
    Kind {
        /// The folder.
        dir: PathBuf,
        /// Kind that was asked for.
        expected: crate::config::Kind,
        /// Kind of the dataset.
        found: crate::config::Kind,
    },
    /// Rows that a dataset does not have.
    #[error("{}: rows {start} to {end} asked for, but the dataset has {rows}", dir.display())]
    OutOfRange {
        /// The folder.
        dir: PathBuf,
        /// First row asked for.
        start: u64,
        /// End of the rows asked for, exclusive.
        end: u64,
        /// Rows there are.
        rows: u64,
    },
    /// The caller asked to stop; what was finished stays.
    #[error(
        "stopped after {rows_done} of {rows_total} rows; the same command continues after the last finished shard"
    )]
    Interrupted {
        /// Rows made so far, those of an unfinished shard included.
        rows_done: u64,
        /// Rows asked for.
        rows_total: u64,
    },
}

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;
