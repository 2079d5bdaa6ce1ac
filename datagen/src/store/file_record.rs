//! Size and digest of a finished file, and the check of the file against them.

use crate::defect::DefectKind;
use crate::digest::digest_of_file;
use crate::error::Error;
use serde::{Deserialize, Serialize};
use std::io::ErrorKind;
use std::path::Path;

/// Size and digest of a finished Parquet file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileRecord {
    /// Path below the folder of the dataset, with `/`.
    pub path: String,
    /// SHA-256.
    pub sha256: String,
    /// Number of rows.
    pub rows: u64,
    /// Size.
    pub bytes: u64,
}

impl FileRecord {
    /// Compares the file with its record; reads the whole file.
    pub(super) fn defect(&self, dir: &Path) -> Option<DefectKind> {
        let path = dir.join(&self.path);
        self.size_defect(dir).or_else(|| digest_defect(&path, &self.sha256))
    }

    /// Compares the size of the file with its record.
    pub(super) fn size_defect(&self, dir: &Path) -> Option<DefectKind> {
        match std::fs::metadata(dir.join(&self.path)) {
            Ok(found) if found.len() == self.bytes => None,
            Ok(found) => Some(DefectKind::Size { expected: self.bytes, found: found.len() }),
            Err(error) => Some(unreadable(&error)),
        }
    }
}

/// Compares the SHA-256 of a file with the recorded one.
pub(super) fn digest_defect(path: &Path, expected: &str) -> Option<DefectKind> {
    match digest_of_file(path) {
        Ok(found) if found == *expected => None,
        Ok(found) => Some(DefectKind::Digest { expected: expected.to_owned(), found }),
        Err(Error::Io { source, .. }) => Some(unreadable(&source)),
        Err(error) => Some(DefectKind::Unreadable(error.to_string())),
    }
}

fn unreadable(error: &std::io::Error) -> DefectKind {
    match error.kind() {
        ErrorKind::NotFound => DefectKind::Missing,
        _ => DefectKind::Unreadable(error.to_string()),
    }
}
