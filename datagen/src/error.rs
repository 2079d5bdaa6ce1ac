//! What can go wrong with a dataset.

use crate::fault::{Fault, lines};
use crate::part::Part;
use crate::rejection::Rejections;
use std::path::{Path, PathBuf};

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
    #[error("{}", incomplete(dir, *files))]
    Incomplete {
        /// The folder.
        dir: PathBuf,
        /// How many files are finished, of how many, if the folder says what it is.
        files: Option<(u64, u64)>,
    },
    /// A folder that lacks files of its dataset.
    #[error("{}", unfinished(dir, *of, missing))]
    Unfinished {
        /// The folder.
        dir: PathBuf,
        /// Files that it should have.
        of: u64,
        /// What it lacks, and the part that makes each.
        missing: Vec<(Part, Fault)>,
    },
    /// A complete dataset that is not as it was written.
    #[error(
        "{}: not as it was written:{}\nfetch it again, or run `dataset generate` with the same configuration: it makes \
         again what is damaged, and only that",
        dir.display(),
        lines(faults)
    )]
    Changed {
        /// The folder.
        dir: PathBuf,
        /// What is wrong.
        faults: Vec<Fault>,
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
    /// A part that there is not.
    #[error("{text}: expected I/N, part I of N with I from 1 to N, as 2/4")]
    Part {
        /// What was given.
        text: String,
    },
    /// A folder that already holds something of a dataset of another configuration.
    #[error(
        "{} is of another configuration (digest {found}, wanted {wanted}); choose another folder, or remove this one",
        path.display()
    )]
    OtherConfig {
        /// What is of another configuration.
        path: PathBuf,
        /// Digest of the configuration there.
        found: String,
        /// Digest of the configuration asked for.
        wanted: String,
    },
    /// An incomplete dataset that another version began: rows may differ between versions.
    #[error(
        "{} was begun by flowservo {found}, and this is {}; complete it with that version, or choose another folder",
        dir.display(),
        env!("CARGO_PKG_VERSION")
    )]
    OtherVersion {
        /// The folder.
        dir: PathBuf,
        /// The version that began it.
        found: String,
    },
    /// A `config.toml` that is not of a dataset.
    #[error(
        "{} is not that of a dataset: {found}; choose another folder, or remove it",
        path.display()
    )]
    NoRecipe {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        found: String,
    },
    /// A configuration that cannot be put into TOML.
    #[error("cannot encode as TOML: {0}")]
    Toml(#[from] toml::ser::Error),
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
        "stopped after {rows_done} of {rows_total} rows, with {files_done} of {files_total} files finished; the same \
         command continues after these"
    )]
    Interrupted {
        /// Rows made so far, those of an unfinished file included.
        rows_done: u64,
        /// Rows asked for.
        rows_total: u64,
        /// Finished files.
        files_done: u64,
        /// Files asked for.
        files_total: u64,
    },
}

/// Says how to go on with a dataset that is incomplete.
fn incomplete(dir: &Path, files: Option<(u64, u64)>) -> String {
    let dir = dir.display();
    match files {
        None => format!(
            "{dir} holds no complete dataset: dataset.json, which is written last, is missing; run `flowservo dataset \
             generate` with its configuration to make it"
        ),
        Some((finished, of)) if finished == of => format!(
            "{dir} holds no complete dataset yet: its {of} files are there; run `flowservo dataset finish {dir}`"
        ),
        Some((finished, of)) => format!(
            "{dir} holds no complete dataset: {finished} of {of} files are finished; run `flowservo dataset generate \
             {dir}/config.toml --out {dir}` to go on"
        ),
    }
}

/// Lists what a dataset lacks, and says how to make it.
fn unfinished(dir: &Path, of: u64, missing: &[(Part, Fault)]) -> String {
    let dir = dir.display();
    let lines = lines(missing.iter().map(|(part, fault)| format!("{fault} (--shard {part})")));
    format!(
        "{dir}: {} of {of} files are there; these are not:{lines}\n`flowservo dataset generate {dir}/config.toml --out \
         {dir}` makes them and finishes the dataset; with a --shard it makes this file alone, on any machine",
        of - missing.len() as u64
    )
}

/// Result of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;
