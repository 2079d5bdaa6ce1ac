//! Names of models: safe as a folder, a URL part and a shell word alike.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};

/// Name of a model: 1 to 64 lower-case ASCII letters, digits, `-` and `_`, beginning with a letter or digit.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct ModelName(String);

impl ModelName {
    /// The name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for ModelName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl FromStr for ModelName {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        text.to_owned().try_into()
    }
}

impl TryFrom<String> for ModelName {
    type Error = Error;

    fn try_from(name: String) -> Result<Self> {
        if is_name(&name) { Ok(Self(name)) } else { Err(Error::Name { name }) }
    }
}

/// Whether `text` keeps the rule for names.
pub(crate) fn is_name(text: &str) -> bool {
    let plain = |c: u8| c.is_ascii_lowercase() || c.is_ascii_digit();
    let bytes = text.as_bytes();
    let starts_plain = bytes.first().is_some_and(|&c| plain(c));
    starts_plain && bytes.len() <= 64 && bytes.iter().all(|&c| plain(c) || c == b'-' || c == b'_')
}

impl From<ModelName> for String {
    fn from(name: ModelName) -> Self {
        name.0
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
}
