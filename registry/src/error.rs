//! Everything that can go wrong, told to the person who can mend it.

use std::path::{Path, PathBuf};

use crate::problem::Problem;

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Why the registry refused or failed. Nothing that was published before is ever changed by a failure.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A model name breaks the rule for names.
    #[error(
        "`{name}` is not a model name: use 1 to 64 lower-case letters, digits, `-` and `_`, beginning with a letter \
         or digit"
    )]
    Name {
        /// The name as given.
        name: String,
    },
    /// The name of an alias breaks the rule for names of aliases.
    #[error(
        "`{name}` is not an alias: use 1 to 64 lower-case letters, digits, `-` and `_`, beginning with a letter; a \
         version is written `NAME@7`"
    )]
    AliasName {
        /// The name as given.
        name: String,
    },
    /// A model reference cannot be read.
    #[error(
        "`{text}` is not a model reference: write `NAME`, `NAME@7`, `NAME:ALIAS` or `NAME@sha256:...` with all 64 digits"
    )]
    Reference {
        /// The reference as given.
        text: String,
    },
    /// A digest cannot be read.
    #[error("`{text}` is not a digest: expected `sha256:` and 64 lower-case hexadecimal digits")]
    Digest {
        /// The digest as given.
        text: String,
    },
    /// A file or folder of a checkpoint cannot be published.
    #[error("{}: {reason}", path.display())]
    Checkpoint {
        /// The offending file or folder.
        path: PathBuf,
        /// What is wrong with it and what to do.
        reason: String,
    },
    /// A metric is NaN or infinite, which JSON cannot hold.
    #[error("metric `{name}` is {value}: only finite numbers can be published")]
    Metric {
        /// Name of the metric.
        name: String,
        /// Its value.
        value: f64,
    },
    /// A version cannot be created.
    #[error("cannot publish {model}: {reason}")]
    Version {
        /// `approach@3`.
        model: String,
        /// What stands against it and what to do.
        reason: String,
    },
    /// The place of a registry cannot be read.
    #[error("`{text}` is no place for a registry: {reason}")]
    Location {
        /// The place as given.
        text: String,
        /// What to write instead.
        reason: String,
    },
    /// A store that would lose a race.
    #[error(
        "{root}: no registry can be kept here: {reason}. Of two that publish at once, one would be lost. A folder has to be \
         on a file system with hard links (not FAT or exFAT), an S3 server has to honour `If-None-Match: *`"
    )]
    Unfit {
        /// Where the registry was to be created.
        root: String,
        /// What the store does.
        reason: String,
    },
    /// There is no registry at this place.
    #[error(
        "{root}: no registry here (registry.json is missing); `model init` or publishing a model creates one"
    )]
    NoRegistry {
        /// Where it was looked for.
        root: String,
    },
    /// A registry was to be created in a folder that holds other things.
    #[error("{root}: holds `{found}` but no registry.json; choose an empty or a new folder for the registry")]
    Occupied {
        /// Where it was to be created.
        root: String,
        /// Something that was found there.
        found: String,
    },
    /// `registry.json` cannot be understood.
    #[error("{root}/registry.json: {reason}")]
    Format {
        /// Where the registry is.
        root: String,
        /// What is wrong with it.
        reason: String,
    },
    /// No version of this model was ever published.
    #[error("{root}: no model `{name}`; published are: {known}")]
    NoModel {
        /// Where the registry is.
        root: String,
        /// The name that was asked for.
        name: String,
        /// The names that exist, separated by commas.
        known: String,
    },
    /// The model has no such version.
    #[error("no version `{reference}`; the newest is {newest}")]
    NoVersion {
        /// The reference that was asked for.
        reference: String,
        /// `approach@7`.
        newest: String,
    },
    /// The model has no such alias.
    #[error("{name}: no alias `{alias}`; its aliases are: {known}")]
    NoAlias {
        /// The model.
        name: String,
        /// The alias that was asked for.
        alias: String,
        /// The aliases that it has, separated by commas.
        known: String,
    },
    /// There is no newest version.
    #[error("{name}: every version is yanked; name one by its number to have it nevertheless, as {newest}")]
    AllYanked {
        /// The model.
        name: String,
        /// `approach@7`.
        newest: String,
    },
    /// What was to be replaced is not what the caller expected.
    #[error("{subject} is {}; nothing was changed", told(*found))]
    Unexpected {
        /// The alias, `approach:champion`.
        subject: String,
        /// Number of the version that it means.
        found: Option<u64>,
    },
    /// An entry of a log cannot be written.
    #[error("{subject}: the entry cannot be written: {reason}")]
    Entry {
        /// What the log is about, `approach:champion`.
        subject: String,
        /// What stands against it and what to do.
        reason: String,
    },
    /// The configuration of a version cannot be compared.
    #[error("{model}: {file} is not TOML: {reason}")]
    Configuration {
        /// `approach@3`.
        model: String,
        /// The file in the checkpoint.
        file: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The registry holds something else than what was published.
    #[error("{0}{remedy}", remedy = .0.fault.remedy())]
    Damaged(Box<Problem>),
    /// The destination of a pull exists and holds something else.
    #[error("{}: {reason}; {model} was not written. Choose a new folder", path.display())]
    Destination {
        /// The destination.
        path: PathBuf,
        /// The version that was asked for.
        model: String,
        /// Why it cannot be used.
        reason: String,
    },
    /// What comes from elsewhere is not what it claims to be.
    #[error("{} {reason}; nothing was published", path.display())]
    Import {
        /// The offending file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A key cannot be read.
    #[error("the key {reason}")]
    Key {
        /// What is wrong with it and what to do.
        reason: String,
    },
    /// A signature does not hold.
    #[error("the signature does not hold: {reason}")]
    Signature {
        /// Why.
        reason: String,
    },
    /// No signature of a version is by the key that was asked for.
    #[error("{model} is not signed with this key: {reason}")]
    Unsigned {
        /// `approach@3`.
        model: String,
        /// What is there instead.
        reason: String,
    },
    /// Something cannot be attached to a version.
    #[error("cannot attach this to {model}: {reason}")]
    Attachment {
        /// `approach@3`.
        model: String,
        /// What stands against it and what to do.
        reason: String,
    },
    /// A local file or folder could not be read or written.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// On which file or folder.
        path: PathBuf,
        /// What the system answered.
        source: std::io::Error,
    },
    /// No credentials for a bucket.
    #[error(
        "{place}: cannot {action}: no credentials. Set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY in the environment (and \
         AWS_SESSION_TOKEN, if they are temporary); the machine, which was asked instead, has none: {source}"
    )]
    Credentials {
        /// What was tried.
        action: &'static str,
        /// The registry's place and the object's key in it.
        place: String,
        /// What the machine answered.
        source: object_store::Error,
    },
    /// An object of the registry could not be read or written.
    #[error("{place}: cannot {action}: {source}")]
    Store {
        /// What was tried.
        action: &'static str,
        /// The registry's place and the object's key in it.
        place: String,
        /// What the store answered.
        source: object_store::Error,
    },
}

impl Error {
    /// An operation on a local file or folder that failed: for `map_err`.
    pub(crate) fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        move |source| Self::Io { action, path: path.to_owned(), source }
    }
}

fn told(version: Option<u64>) -> String {
    version.map_or("no version".into(), |number| format!("version {number}"))
}

impl From<Problem> for Error {
    fn from(problem: Problem) -> Self {
        Self::Damaged(Box::new(problem))
    }
}
