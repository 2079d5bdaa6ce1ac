//! Records of finished shards, kept in `shards/` until the dataset is complete.

use super::config_file::config_digest;
use super::file_record::FileRecord;
use super::json;
use super::shard::Shard;
use crate::config::DatasetConfig;
use crate::defect::DefectKind;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::io::ErrorKind;
use std::path::Path;

/// Folder of the records.
const FOLDER: &str = "shards";

/// Record of a finished shard.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShardRecord {
    /// Digest of the configuration.
    pub(super) config_digest: String,
    /// Version of flowservo that generated the shard.
    pub(super) version: String,
    /// Size and digest of the file.
    pub(super) file: FileRecord,
}

impl ShardRecord {
    /// Reads all records of a dataset. Skips records that cannot be parsed, so that their shards are generated again.
    pub(super) fn all(dir: &Path) -> Result<Vec<Self>> {
        let folder = dir.join(FOLDER);
        let entries = match std::fs::read_dir(&folder) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            found => found.map_err(Error::io(&folder))?,
        };
        let mut paths = Vec::new();
        for entry in entries {
            let path = entry.map_err(Error::io(&folder))?.path();
            if path.extension().is_some_and(|extension| extension == "json") {
                paths.push(path);
            }
        }
        paths.sort();
        let mut records = Vec::new();
        for path in paths {
            match json::read(&path) {
                Ok(record) => records.push(record),
                Err(Error::Damaged { .. }) => {}
                // Another process has just completed the dataset.
                Err(Error::Io { source, .. }) if source.kind() == ErrorKind::NotFound => {}
                Err(error) => return Err(error),
            }
        }
        Ok(records)
    }

    /// Publishes the record of a shard.
    pub(super) fn publish(&self, shard: &Shard, dir: &Path) -> Result<()> {
        let folder = dir.join(FOLDER);
        let path = folder.join(format!("{}.json", shard.name()));
        loop {
            std::fs::create_dir_all(&folder).map_err(Error::io(&folder))?;
            match json::write(&path, self) {
                // Another process has just completed the dataset and removed the folder.
                Err(Error::Io { source, .. }) if source.kind() == ErrorKind::NotFound => {}
                written => return written,
            }
        }
    }

    /// Compares the shard with its record, and the record with a configuration and this version; reads the whole file.
    pub(super) fn defect(&self, config_digest: &str, dir: &Path) -> Option<DefectKind> {
        if self.config_digest != config_digest {
            return Some(DefectKind::OtherConfig(self.config_digest.clone()));
        }
        if self.version != env!("CARGO_PKG_VERSION") {
            return Some(DefectKind::OtherVersion(self.version.clone()));
        }
        self.file.defect(dir)
    }
}

/// Removes all records of a complete dataset, whose `dataset.json` replaces them.
pub(super) fn remove_all(dir: &Path) -> Result<()> {
    let folder = dir.join(FOLDER);
    match std::fs::remove_dir_all(&folder) {
        // Another process has removed it, or is writing a shard again and will remove it.
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::DirectoryNotEmpty) => Ok(()),
        removed => removed.map_err(Error::io(&folder)),
    }
}

/// Returns the number of finished shards of an incomplete dataset, judged by their records and sizes.
pub fn finished_shards(config: &DatasetConfig, dir: &Path) -> Result<u64> {
    let (records, config_digest) = (ShardRecord::all(dir)?, config_digest(config)?);
    let paths: BTreeSet<String> = Shard::all(config).iter().map(Shard::path).collect();
    let is_finished = |record: &&ShardRecord| {
        record.config_digest == config_digest
            && paths.contains(&record.file.path)
            && record.file.size_defect(dir).is_none()
    };
    Ok(records.iter().filter(is_finished).count() as u64)
}
