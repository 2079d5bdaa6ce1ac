//! Errors of a virtual environment.

/// Error of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An invalid value in the configuration.
    #[error("world.{key} = {value}: expected {expected}")]
    Config {
        /// Key, relative to `world`.
        key: &'static str,
        /// Actual value.
        value: String,
        /// Valid values.
        expected: &'static str,
    },
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;
