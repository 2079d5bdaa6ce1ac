//! Locations of registries: a folder, or a bucket of an object store.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::error::{Error, Result};

/// Location of a registry.
///
/// As text, `s3://BUCKET` and `s3://BUCKET/PREFIX` are locations on Amazon S3 or a compatible server. Everything without `://`
/// is a folder.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Location {
    /// A folder.
    Folder(PathBuf),
    /// A bucket, or a prefix in it: `BUCKET` or `BUCKET/PREFIX`.
    #[cfg(feature = "s3")]
    Bucket(String),
}

impl Location {
    /// Returns the folder, if it is one.
    pub fn folder(&self) -> Option<&Path> {
        match self {
            Self::Folder(folder) => Some(folder),
            #[cfg(feature = "s3")]
            Self::Bucket(_) => None,
        }
    }
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Folder(folder) => folder.display().fmt(f),
            #[cfg(feature = "s3")]
            Self::Bucket(place) => write!(f, "s3://{place}"),
        }
    }
}

impl FromStr for Location {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let refuse = |reason: &str| Error::refused(&text, reason);
        match text.split_once("://") {
            None if text.is_empty() => Err(refuse("name a folder")),
            None => Ok(Self::Folder(text.into())),
            Some(("s3", place)) => bucket(place).map_err(refuse),
            Some(_) => Err(refuse("give a folder, or s3://BUCKET/PREFIX")),
        }
    }
}

#[cfg(feature = "s3")]
fn bucket(place: &str) -> std::result::Result<Location, &'static str> {
    let place = place.strip_suffix('/').unwrap_or(place);
    let is_safe = |part: &str| {
        !matches!(part, "" | "." | "..")
            && part.bytes().all(|c| c.is_ascii_alphanumeric() || b".-_=".contains(&c))
    };
    if place.split('/').all(is_safe) {
        return Ok(Location::Bucket(place.to_owned()));
    }
    Err("write s3://BUCKET/PREFIX with letters, digits, `.`, `-`, `_` and `=` between the slashes")
}

#[cfg(not(feature = "s3"))]
fn bucket(_: &str) -> std::result::Result<Location, &'static str> {
    Err("this program was built without S3; build it with `cargo build --release --features s3`")
}

// No conversion from text but `FromStr`: an address must not be mistaken for a folder.
impl From<&Path> for Location {
    fn from(folder: &Path) -> Self {
        Self::Folder(folder.to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_and_addresses() {
        for folder in ["models", "../shared/models", "/srv/models", "C:\\models", "a:b"] {
            assert_eq!(folder.parse::<Location>().unwrap().folder(), Some(Path::new(folder)));
        }
        for bad in ["", "gs://bucket/models", "file:///srv/models", "s3://", "s3:///models"] {
            assert!(bad.parse::<Location>().is_err(), "{bad}");
        }
    }

    #[cfg(feature = "s3")]
    #[test]
    fn buckets_and_prefixes() {
        for (text, expected) in
            [("s3://lab", "s3://lab"), ("s3://lab/", "s3://lab"), ("s3://lab/a/b/", "s3://lab/a/b")]
        {
            let location: Location = text.parse().unwrap();
            assert_eq!((location.to_string().as_str(), location.folder()), (expected, None));
        }
        for bad in ["s3://lab/../x", "s3://lab//x", "s3://la b", "s3://lab/a?b", "s3://../x"] {
            assert!(bad.parse::<Location>().is_err(), "{bad}");
        }
    }

    #[cfg(not(feature = "s3"))]
    #[test]
    fn without_s3_the_error_explains_how_to_build_with_it() {
        let message = "s3://lab/models".parse::<Location>().unwrap_err().to_string();
        assert!(message.contains("s3://lab/models") && message.contains("--features s3"), "{message}");
    }
}
