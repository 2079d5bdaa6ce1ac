//! Names of models and aliases: safe as a folder, a part of a URL and a shell word.

use std::fmt;
use std::str::FromStr;

use serde::Serialize;

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

    fn from_str(name: &str) -> Result<Self> {
        let expected = "a model name: use 1 to 64 lower-case letters, digits, `-` and `_`, starting with a letter or digit";
        if is_name(name) {
            Ok(Self(name.to_owned()))
        } else {
            Err(Error::Invalid { text: name.to_owned(), expected })
        }
    }
}

impl FromStr for AliasName {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let expected = "an alias: use 1 to 64 lower-case letters, digits, `-` and `_`, starting with a letter; a version is written \
                        `NAME@7`";
        let is_alias = is_name(name) && name.starts_with(|c: char| c.is_ascii_lowercase());
        if is_alias {
            Ok(Self(name.to_owned()))
        } else {
            Err(Error::Invalid { text: name.to_owned(), expected })
        }
    }
}

/// Returns whether `text` follows the rule for names.
fn is_name(text: &str) -> bool {
    let is_alphanumeric = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit();
    let bytes = text.as_bytes();
    let starts_well = bytes.first().is_some_and(|&c| is_alphanumeric(c));
    starts_well && bytes.len() <= 64 && bytes.iter().all(|&c| is_alphanumeric(c) || c == b'-' || c == b'_')
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
}
