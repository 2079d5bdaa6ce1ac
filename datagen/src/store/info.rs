//! `dataset.json`: the manifest of a dataset. It is written last, so its presence means that the dataset is complete.

use super::config_file;
use super::file_record::{FileRecord, digest_defect};
use super::json;
use super::shard_record::finished_shards;
use crate::config::DatasetConfig;
use crate::defect::Defect;
use crate::digest::digest;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::Path;

/// Name of the file.
pub(super) const FILE_NAME: &str = "dataset.json";

/// Manifest of a complete dataset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetInfo {
    /// Name of the dataset.
    pub name: String,
    /// Number of rows.
    pub rows: u64,
    /// Number of images.
    pub images: u64,
    /// Identity of the data: SHA-256 over a line `digest  path` for each file, sorted by path.
    pub digest: String,
    /// SHA-256 of the configuration.
    pub config_digest: String,
    /// Version of flowservo that generated the dataset.
    pub version: String,
    /// Parquet files, in the order of their rows.
    pub files: Vec<FileRecord>,
    /// SHA-256 of `README.md` and `config.toml`.
    pub documents: BTreeMap<String, String>,
    /// Complete configuration.
    pub config: DatasetConfig,
    /// SHA-256 of this manifest with an empty seal, which reveals any change of the manifest itself.
    pub seal: String,
}

impl DatasetInfo {
    /// Reads `dataset.json` in a folder. Fails unless it is byte for byte as written.
    pub fn read(dir: &Path) -> Result<Self> {
        let path = dir.join(FILE_NAME);
        let bytes = match std::fs::read(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Err(incomplete(dir)),
            found => found.map_err(Error::io(&path))?,
        };
        let info: Self = json::parse(&path, &bytes)?;
        if info.compute_seal()? == info.seal && json::format(&info)? == bytes {
            return Ok(info);
        }
        Err(Error::damaged(&path, "a manifest as written by flowservo", "one that was changed later"))
    }

    /// Computes the seal from all other fields.
    pub(super) fn compute_seal(&self) -> Result<String> {
        Ok(digest(&json::format(&Self { seal: String::new(), ..self.clone() })?))
    }

    /// Returns the total size of the Parquet files.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.bytes).sum()
    }

    /// Checks that all Parquet files exist and have the recorded sizes. This is fast; [`verify`](super::verify()) reads them.
    pub fn check_sizes(&self, dir: &Path) -> Result<()> {
        for file in &self.files {
            let path = dir.join(&file.path);
            let found = std::fs::metadata(&path).map_err(Error::io(&path))?.len();
            if found != file.bytes {
                return Err(Error::damaged(&path, format!("{} bytes", file.bytes), format!("{found} bytes")));
            }
        }
        Ok(())
    }

    /// Returns the defects of card and configuration.
    pub(super) fn document_defects(&self, dir: &Path) -> Vec<Defect> {
        let defect = |(path, digest): (&String, &String)| {
            let kind = digest_defect(&dir.join(path), digest)?;
            Some(Defect { path: path.clone(), kind })
        };
        self.documents.iter().filter_map(defect).collect()
    }
}

/// Creates the error for a folder without `dataset.json`. It includes the progress if the folder has a configuration.
fn incomplete(dir: &Path) -> Error {
    let files = || {
        let config = config_file::read(dir).ok()??;
        config.validate().ok()?;
        Some((finished_shards(&config, dir).ok()?, config.shards()))
    };
    Error::Incomplete { dir: dir.to_owned(), files: files() }
}
