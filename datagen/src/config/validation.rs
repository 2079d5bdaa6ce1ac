//! Checks of configuration values, and their error.

use std::fmt;

/// An invalid dataset configuration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// A value out of range.
    #[error("{key} = {value}: expected {expected}")]
    Value {
        /// Key, with its tables.
        key: String,
        /// Value found.
        value: String,
        /// Description of the valid values.
        expected: &'static str,
    },
    /// A missing or unknown key, or a value of the wrong type.
    #[error("dataset configuration: {0}")]
    Form(#[from] toml::de::Error),
    /// An invalid environment.
    #[error(transparent)]
    World(#[from] world::Error),
}

/// Result of parsing or validating a configuration.
pub type Result<T, E = ConfigError> = std::result::Result<T, E>;

/// Checks a condition on the value of a key.
pub(super) fn require(
    key: impl Into<String>,
    holds: bool,
    value: impl fmt::Display,
    expected: &'static str,
) -> Result<()> {
    if holds {
        Ok(())
    } else {
        Err(ConfigError::Value { key: key.into(), value: value.to_string(), expected })
    }
}

/// Checks that `[from, to]` is ascending and within limits.
pub(super) fn require_interval(
    key: impl Into<String>,
    value: [f64; 2],
    within: [f64; 2],
    expected: &'static str,
) -> Result<()> {
    let holds = within[0] <= value[0] && value[0] <= value[1] && value[1] <= within[1];
    require(key, holds, format!("{value:?}"), expected)
}
