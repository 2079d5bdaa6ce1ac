//! `dataset.json`: what a dataset is made of. Written last, so it says that the dataset is complete.

use crate::config::DatasetConfig;
use crate::error::{Error, Result};
use crate::publish::{digest, digest_of_file, io, publish};
use serde::{Deserialize, Serialize};
use std::io::Write as _;
use std::path::Path;

/// Name of the file.
pub const FILE_NAME: &str = "dataset.json";

/// What a dataset is made of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetInfo {
    /// Name of the dataset.
    pub name: String,
    /// Number of rows.
    pub rows: u64,
    /// Number of images.
    pub images: u64,
    /// SHA-256 over `digest  path` of all files, a line each, sorted by path: the identity of the data.
    pub digest: String,
    /// SHA-256 of the configuration.
    pub config_digest: String,
    /// Version of flowservo that wrote it.
    pub version: String,
    /// The files with the rows, in their order.
    pub files: Vec<FileRecord>,
    /// The configuration that made it, complete.
    pub config: DatasetConfig,
}

/// A finished file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileRecord {
    /// Path below the dataset's folder, with `/`.
    pub path: String,
    /// SHA-256.
    pub sha256: String,
    /// Rows in it.
    pub rows: u64,
    /// Its size.
    pub bytes: u64,
}

impl DatasetInfo {
    /// For files in their order.
    pub fn new(config: &DatasetConfig, files: Vec<FileRecord>) -> Result<Self> {
        let images_per_row = config.motions[0].ranges().count() as u64;
        let lines: Vec<String> =
            files.iter().map(|file| format!("{}  {}\n", file.sha256, file.path)).collect();
        Ok(Self {
            name: config.name.clone(),
            rows: config.count,
            images: config.count * images_per_row,
            digest: digest(lines.concat().as_bytes()),
            config_digest: config_digest(config)?,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            files,
            config: config.clone(),
        })
    }

    /// Reads `dataset.json` in a folder.
    pub fn read(dir: &Path) -> Result<Self> {
        let path = dir.join(FILE_NAME);
        if !path.exists() {
            return Err(Error::Incomplete { dir: dir.to_owned() });
        }
        read_json(&path)
    }

    /// Writes `dataset.json` into a folder.
    pub fn write(&self, dir: &Path) -> Result<()> {
        write_json(&dir.join(FILE_NAME), self)
    }

    /// Size of all files with rows.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.bytes).sum()
    }

    /// Are all files there, with the sizes they should have? Quick; [`DatasetInfo::verify`] reads them.
    pub fn check_sizes(&self, dir: &Path) -> Result<()> {
        for file in &self.files {
            let path = dir.join(&file.path);
            let found = std::fs::metadata(&path).map_err(|source| io(&path, source))?.len();
            if found != file.bytes {
                let [expected, found] = [file.bytes, found].map(|bytes| format!("{bytes} bytes"));
                return Err(Error::Damaged { path, expected, found });
            }
        }
        Ok(())
    }

    /// Compares the digest of every file with its record, and all records with the dataset's digest.
    pub fn verify(&self, dir: &Path) -> Result<()> {
        let recorded = Self::new(&self.config, self.files.clone())?;
        let path = dir.join(FILE_NAME);
        if recorded.digest != self.digest {
            return Err(Error::Damaged { path, expected: recorded.digest, found: self.digest.clone() });
        }
        if recorded.config_digest != self.config_digest {
            return Err(Error::Damaged {
                path,
                expected: recorded.config_digest,
                found: self.config_digest.clone(),
            });
        }
        self.files.iter().try_for_each(|file| file.verify(dir))
    }
}

impl FileRecord {
    /// Of a file that is there.
    pub fn of(dir: &Path, path: String, rows: u64) -> Result<Self> {
        let file = dir.join(&path);
        let bytes = std::fs::metadata(&file).map_err(|source| io(&file, source))?.len();
        Ok(Self { path, sha256: digest_of_file(&file)?, rows, bytes })
    }

    /// Compares the digest of the file with the record.
    pub fn verify(&self, dir: &Path) -> Result<()> {
        let path = dir.join(&self.path);
        let found = digest_of_file(&path)?;
        if found == self.sha256 {
            return Ok(());
        }
        Err(Error::Damaged { path, expected: format!("SHA-256 {}", self.sha256), found })
    }
}

/// SHA-256 of a configuration: of its JSON form, so comments and the order of keys in a file do not matter.
pub fn config_digest(config: &DatasetConfig) -> Result<String> {
    Ok(digest(&serde_json::to_vec(config)?))
}

pub(crate) fn read_json<T: for<'a> Deserialize<'a>>(path: &Path) -> Result<T> {
    let text = std::fs::read(path).map_err(|source| io(path, source))?;
    serde_json::from_slice(&text).map_err(|error| Error::Damaged {
        path: path.to_owned(),
        expected: "a description as flowservo writes it".to_owned(),
        found: error.to_string(),
    })
}

pub(crate) fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    let mut text = serde_json::to_vec_pretty(value)?;
    text.push(b'\n');
    publish(path, |file| file.write_all(&text).map_err(|source| io(path, source)))
}
