//! JSON files: read strictly, published atomically.

use crate::error::{Error, Result};
use crate::publish::publish;
use serde::{Deserialize, Serialize};
use std::io::Write as _;
use std::path::Path;

/// Reads a JSON file.
pub(super) fn read<T: for<'a> Deserialize<'a>>(path: &Path) -> Result<T> {
    parse(path, &std::fs::read(path).map_err(Error::io(path))?)
}

/// Parses the content of a JSON file. The path is for the error message.
pub(super) fn parse<T: for<'a> Deserialize<'a>>(path: &Path, bytes: &[u8]) -> Result<T> {
    serde_json::from_slice(bytes).map_err(|error| Error::damaged(path, "JSON as written by flowservo", error))
}

/// Publishes a value as a JSON file.
pub(super) fn write(path: &Path, value: &impl Serialize) -> Result<()> {
    let text = format(value)?;
    publish(path, |file| file.write_all(&text).map_err(Error::io(path)))
}

/// Formats a value as the content of a JSON file.
pub(super) fn format(value: &impl Serialize) -> Result<Vec<u8>> {
    let mut text = serde_json::to_vec_pretty(value)?;
    text.push(b'\n');
    Ok(text)
}
