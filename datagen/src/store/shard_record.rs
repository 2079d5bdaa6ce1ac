//! Records of finished files, while the dataset is incomplete.

use crate::config::DatasetConfig;
use crate::error::{Error, Result};
use crate::fault::Problem;
use crate::info::{FileRecord, config_digest, read_json, write_json};
use crate::publish::io;
use crate::shard::Shard;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::io::ErrorKind;
use std::path::Path;

/// Folder of the records.
pub const FOLDER: &str = "shards";

/// What is known of a finished file.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShardRecord {
    /// Digest of the configuration that it belongs to.
    pub config_digest: String,
    /// Version of flowservo that made it.
    pub version: String,
    /// The file.
    pub file: FileRecord,
}

impl ShardRecord {
    /// The records in a dataset's folder. One that cannot be understood is left out: its file is made again.
    pub fn all(dir: &Path) -> Result<Vec<Self>> {
        let folder = dir.join(FOLDER);
        let entries = match std::fs::read_dir(&folder) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            found => found.map_err(|source| io(&folder, source))?,
        };
        let mut paths = Vec::new();
        for entry in entries {
            let path = entry.map_err(|source| io(&folder, source))?.path();
            if path.extension().is_some_and(|extension| extension == "json") {
                paths.push(path);
            }
        }
        paths.sort();
        let mut records = Vec::new();
        for path in paths {
            match read_json(&path) {
                Ok(record) => records.push(record),
                Err(Error::Damaged { .. }) => {}
                // Another process has completed the dataset just now.
                Err(Error::Io { source, .. }) if source.kind() == ErrorKind::NotFound => {}
                Err(error) => return Err(error),
            }
        }
        Ok(records)
    }

    /// Path of a shard's record below the dataset's folder.
    pub fn path(shard: &Shard) -> String {
        format!("{FOLDER}/{}.json", shard.name())
    }

    /// Publishes the record of a shard.
    pub(crate) fn publish(&self, shard: &Shard, dir: &Path) -> Result<()> {
        let folder = dir.join(FOLDER);
        loop {
            std::fs::create_dir_all(&folder).map_err(|source| io(&folder, source))?;
            match write_json(&dir.join(Self::path(shard)), self) {
                // Another process has completed the dataset, and removed the folder, just now.
                Err(Error::Io { source, .. }) if source.kind() == ErrorKind::NotFound => {}
                written => return written,
            }
        }
    }

    /// What is wrong with the file of a record, for a configuration with this digest; reads the file.
    pub(crate) fn problem(&self, config_digest: &str, dir: &Path) -> Option<Problem> {
        if self.config_digest != config_digest {
            return Some(Problem::OtherConfig(self.config_digest.clone()));
        }
        if self.version != env!("CARGO_PKG_VERSION") {
            return Some(Problem::OtherVersion(self.version.clone()));
        }
        self.file.problem(dir)
    }
}

/// Removes the records: `dataset.json` has taken their place.
pub(crate) fn remove_all(dir: &Path) -> Result<()> {
    let folder = dir.join(FOLDER);
    match std::fs::remove_dir_all(&folder) {
        // Another process has done it, or is making a file once more, and will do it.
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::DirectoryNotEmpty) => Ok(()),
        removed => removed.map_err(|source| io(&folder, source)),
    }
}

/// How many files of an incomplete dataset are finished, by their records and sizes.
pub fn finished(config: &DatasetConfig, dir: &Path) -> Result<u64> {
    let (records, config_digest) = (ShardRecord::all(dir)?, config_digest(config)?);
    let paths: BTreeSet<String> = Shard::all(config).iter().map(Shard::path).collect();
    let is_finished = |record: &&ShardRecord| {
        let ShardRecord { file, .. } = record;
        record.config_digest == config_digest
            && paths.contains(&file.path)
            && Problem::of_size(&dir.join(&file.path), file.bytes).is_none()
    };
    Ok(records.iter().filter(is_finished).count() as u64)
}
