//! Names of models and aliases, safe as a folder, a part of a URL and a shell word. References to versions: `approach`,
//! `approach@3`, `approach@sha256:...`, `approach:champion`.

use std::fmt;
use std::str::FromStr;

use serde::Serialize;

use crate::digest::Digest;
use crate::error::{Error, Result};

/// Name of a model: 1 to 64 lower-case ASCII letters, digits, `-` and `_`, starting with a letter or digit.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct ModelName(String);

/// Name of an alias: like a model's name, but it starts with a letter, so that it cannot be confused with a version.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
pub struct AliasName(String);

impl ModelName {
    /// Returns the name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for ModelName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl fmt::Display for AliasName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for ModelName {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let expected = "a model name: use 1 to 64 lower-case letters, digits, `-` and `_`, starting with a letter or digit";
        valid(is_name(text), text, expected).map(Self)
    }
}

impl FromStr for AliasName {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let expected = "an alias: use 1 to 64 lower-case letters, digits, `-` and `_`, starting with a letter; a version is written \
                        `NAME@7`";
        valid(is_name(text) && text.starts_with(|c: char| c.is_ascii_lowercase()), text, expected).map(Self)
    }
}

/// Returns whether `text` follows the rule for names.
fn is_name(text: &str) -> bool {
    let is_alphanumeric = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit();
    let bytes = text.as_bytes();
    let starts_well = bytes.first().is_some_and(|&c| is_alphanumeric(c));
    starts_well && bytes.len() <= 64 && bytes.iter().all(|&c| is_alphanumeric(c) || c == b'-' || c == b'_')
}

/// Returns the text if it `is_valid`.
fn valid(is_valid: bool, text: &str, expected: &'static str) -> Result<String> {
    let text = text.to_owned();
    if is_valid { Ok(text) } else { Err(Error::Invalid { text, expected }) }
}

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
    fn names() {
        for good in ["approach", "a", "7", "cnn_avoid-vga2", &"x".repeat(64)] {
            assert_eq!(good.parse::<ModelName>().unwrap().as_str(), good);
        }
        let long = "x".repeat(65);
        for bad in
            ["", "A", "../x", "a/b", "a\\b", ".", "..", "-rf", "_a", "a b", "a.b", "a@1", "é", "a\0", &long]
        {
            assert!(bad.parse::<ModelName>().is_err(), "{bad:?}");
        }
        let message = "../x".parse::<ModelName>().unwrap_err().to_string();
        assert!(message.contains("`../x`") && message.contains("lower-case"), "{message}");
    }

    #[test]
    fn aliases() {
        for good in ["champion", "a", "best-2026"] {
            assert_eq!(good.parse::<AliasName>().unwrap().to_string(), good);
        }
        for bad in ["", "3", "3rd", "Champion", "a/b", "..", "a:b", "a@1", "-a"] {
            assert!(bad.parse::<AliasName>().is_err(), "{bad}");
        }
    }

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
