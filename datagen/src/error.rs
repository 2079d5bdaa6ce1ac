//! Errors of this crate.

use crate::config::{ConfigError, Kind};
use crate::defect::Defect;
use crate::scene::Rejections;
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// An error of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An invalid configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// No acceptable scene within the allowed number of draws.
    #[error(transparent)]
    Unplaceable(#[from] Rejections),
    /// A failure to generate one example.
    #[error("example {index}: {source}")]
    Example {
        /// Index in the dataset.
        index: u64,
        /// Cause.
        source: Box<Error>,
    },
    /// A failure to encode or decode a PNG image.
    #[error("PNG image: {0}")]
    Png(#[from] image::ImageError),
    /// A failure to encode rows as Arrow columns.
    #[error("cannot encode rows: {0}")]
    Encode(#[from] arrow_schema::ArrowError),
    /// A failure to encode JSON.
    #[error("cannot encode as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// A failure to encode TOML.
    #[error("cannot encode as TOML: {0}")]
    Toml(#[from] toml::ser::Error),
    /// A failure to read or write a file.
    #[error("{}: {source}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A damaged or foreign file.
    #[error(
        "{}: expected {expected}, found {found}; generate the dataset again, or download it again",
        path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Expected content.
        expected: String,
        /// Actual content.
        found: String,
    },
    /// A folder without a complete dataset.
    #[error("{}", incomplete(dir, *files))]
    Incomplete {
        /// The folder.
        dir: PathBuf,
        /// Number of finished files and of all files, if the folder has the configuration of a dataset.
        files: Option<(u64, u64)>,
    },
    /// A dataset that cannot be finished because files are missing or damaged.
    #[error("{}", unfinished(dir, *files, missing))]
    Unfinished {
        /// The folder.
        dir: PathBuf,
        /// Number of files of the dataset.
        files: u64,
        /// Missing and damaged files, each with its number, counted from 1.
        missing: Vec<(u64, Defect)>,
    },
    /// A complete dataset with defects.
    #[error(
        "{}: changed since it was written:{}\ndownload the dataset again, or run `dataset generate` with the same configuration, \
         which regenerates only the damaged files",
        dir.display(),
        lines(defects)
    )]
    Defective {
        /// The folder.
        dir: PathBuf,
        /// All defects.
        defects: Vec<Defect>,
    },
    /// A file that another process is writing.
    #[error(
        "{}: another process is writing this file; wait for it, or give each process its own part with --shard I/N",
        path.display()
    )]
    Busy {
        /// The file.
        path: PathBuf,
    },
    /// A folder that belongs to another configuration.
    #[error(
        "{} belongs to another configuration (digest {found}, expected {expected}); choose another folder, or remove it",
        path.display()
    )]
    OtherConfig {
        /// The file that belongs to another configuration.
        path: PathBuf,
        /// Digest of its configuration.
        found: String,
        /// Digest of the requested configuration.
        expected: String,
    },
    /// An incomplete dataset that another version of flowservo started. Rows can differ between versions.
    #[error(
        "{} was started by flowservo {found}, but this is {}; complete it with that version, or choose another folder",
        dir.display(),
        env!("CARGO_PKG_VERSION")
    )]
    OtherVersion {
        /// The folder.
        dir: PathBuf,
        /// Version that started the dataset.
        found: String,
    },
    /// A `config.toml` that is not a dataset configuration.
    #[error(
        "{} is not a dataset configuration: {found}; choose another folder, or remove the file",
        path.display()
    )]
    NotDatasetConfig {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        found: String,
    },
    /// A Parquet file that is not part of the dataset. Data tools would read it, too.
    #[error("{} does not belong to this dataset; remove it, or choose another folder", path.display())]
    Stray {
        /// The file.
        path: PathBuf,
    },
    /// A dataset of the wrong kind.
    #[error("{} is a dataset of kind {found}; {expected} is needed here", dir.display())]
    Kind {
        /// The folder.
        dir: PathBuf,
        /// Requested kind.
        expected: Kind,
        /// Kind of the dataset.
        found: Kind,
    },
    /// A range of rows that exceeds the dataset.
    #[error("{}: requested rows {start} to {end} (exclusive), but the dataset has {rows}", dir.display())]
    OutOfRange {
        /// The folder.
        dir: PathBuf,
        /// First requested row.
        start: u64,
        /// End of the requested rows, exclusive.
        end: u64,
        /// Number of rows in the dataset.
        rows: u64,
    },
    /// Generation stopped at the request of the caller. Finished files are kept.
    #[error(
        "stopped after {rows_done} of {rows_total} rows, with {files_done} of {files_total} files finished; the same \
         command continues from there"
    )]
    Interrupted {
        /// Rows generated so far, including those of an unfinished file.
        rows_done: u64,
        /// Rows requested.
        rows_total: u64,
        /// Finished files.
        files_done: u64,
        /// Files requested.
        files_total: u64,
    },
}

impl Error {
    /// Converts errors of the operating system at a path.
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self + Copy {
        move |source| Self::Io { path: path.to_owned(), source }
    }

    /// Creates the error for a damaged or foreign file.
    pub(crate) fn damaged(path: &Path, expected: impl Into<String>, found: impl Display) -> Self {
        Self::Damaged { path: path.to_owned(), expected: expected.into(), found: found.to_string() }
    }
}

/// Describes how to complete a dataset.
fn incomplete(dir: &Path, files: Option<(u64, u64)>) -> String {
    let dir = dir.display();
    match files {
        None => format!(
            "{dir} holds no complete dataset: dataset.json, which is written last, is missing; run `flowservo dataset \
             generate` with the configuration to create it"
        ),
        Some((finished, files)) if finished == files => format!(
            "{dir} holds no complete dataset yet: all {files} files are there; run `flowservo dataset finish {dir}`"
        ),
        Some((finished, files)) => format!(
            "{dir} holds no complete dataset: {finished} of {files} files are finished; run `flowservo dataset generate \
             {dir}/config.toml --out {dir}` to continue"
        ),
    }
}

/// Lists missing and damaged files, and describes how to generate them.
fn unfinished(dir: &Path, files: u64, missing: &[(u64, Defect)]) -> String {
    let dir = dir.display();
    let lines = lines(missing.iter().map(|(number, defect)| format!("{defect} (--shard {number}/{files})")));
    format!(
        "{dir}: {} of {files} files are there; these are missing or damaged:{lines}\n`flowservo dataset generate \
         {dir}/config.toml --out {dir}` generates them and finishes the dataset; with --shard it generates a single file, on \
         any machine",
        files - missing.len() as u64
    )
}

/// Formats items as indented lines.
fn lines<T: Display>(items: impl IntoIterator<Item = T>) -> String {
    items.into_iter().fold(String::new(), |text, item| text + &format!("\n  {item}"))
}

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;
