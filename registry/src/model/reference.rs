//! References to versions: `approach`, `approach@3`, `approach@sha256:...`, `approach:champion`.

use std::fmt;
use std::str::FromStr;

use super::name::{AliasName, ModelName};
use crate::digest::Digest;
use crate::error::{Error, Result};

/// A reference to a version of a model.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ModelRef {
    /// The model.
    pub name: ModelName,
    /// The version.
    pub selector: Selector,
}

/// Selects a version of a model.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Selector {
    /// The newest version that is not yanked.
    Newest,
    /// The version with this number, from 1.
    Version(u64),
    /// The version whose manifest has this digest.
    Digest(Digest),
    /// The version that this alias names now.
    Alias(AliasName),
}

impl fmt::Display for ModelRef {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.selector {
            Selector::Newest => write!(f, "{}", self.name),
            Selector::Version(number) => write!(f, "{}@{number}", self.name),
            Selector::Digest(digest) => write!(f, "{}@{digest}", self.name),
            Selector::Alias(alias) => write!(f, "{}:{alias}", self.name),
        }
    }
}

impl FromStr for ModelRef {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let Some((name, version)) = text.split_once('@') else {
            let Some((name, alias)) = text.split_once(':') else {
                return Ok(Self { name: text.parse()?, selector: Selector::Newest });
            };
            return Ok(Self { name: name.parse()?, selector: Selector::Alias(alias.parse()?) });
        };
        let selector = if let Ok(digest) = version.parse() {
            Selector::Digest(digest)
        } else {
            // One spelling for each number: no sign and no leading zero.
            let is_canonical = version.bytes().all(|c| c.is_ascii_digit()) && !version.starts_with('0');
            let number = version.parse().ok().filter(|_| is_canonical);
            let expected = "a model reference: write `NAME`, `NAME@7`, `NAME:ALIAS` or `NAME@sha256:...` with all 64 digits";
            Selector::Version(number.ok_or_else(|| Error::Invalid { text: text.to_owned(), expected })?)
        };
        Ok(Self { name: name.parse()?, selector })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn references() {
        let digest = Digest::of(b"x");
        let cases = [
            ("approach".to_owned(), Selector::Newest),
            ("approach@3".to_owned(), Selector::Version(3)),
            (format!("approach@{digest}"), Selector::Digest(digest)),
            ("approach:champion".to_owned(), Selector::Alias("champion".parse().unwrap())),
        ];
        for (text, selector) in cases {
            let reference: ModelRef = text.parse().unwrap();
            assert_eq!((reference.name.as_str(), &reference.selector), ("approach", &selector));
            assert_eq!(reference.to_string(), text);
        }
        for bad in [
            "approach@",
            "approach@0",
            "approach@03",
            "approach@+3",
            "approach@v3",
            "approach@1@2",
            "@3",
            "A@3",
            "approach:",
            "approach:3",
            "approach:a@3",
            "approach@3:a",
            ":a",
            "A:a",
        ] {
            assert!(bad.parse::<ModelRef>().is_err(), "{bad}");
        }
        let truncated = format!("approach@{}", &digest.to_string()[..20]);
        assert!(truncated.parse::<ModelRef>().unwrap_err().to_string().contains("all 64 digits"));
    }
}
