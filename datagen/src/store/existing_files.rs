//! Files of a dataset left by earlier runs, on this or on other machines.

use super::config_file::{self, config_digest};
use super::file_record::FileRecord;
use super::info::{self, DatasetInfo};
use super::shard::Shard;
use super::shard_record::ShardRecord;
use crate::config::DatasetConfig;
use crate::defect::DefectKind;
use crate::error::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::Path;

/// Records of existing files: the manifest if the dataset is complete, and the records of finished shards if it is not.
pub(super) struct ExistingFiles {
    config_digest: String,
    pub(super) info: Option<DatasetInfo>,
    records: BTreeMap<String, ShardRecord>,
}

impl ExistingFiles {
    /// Reads the records in a folder, for the dataset of a configuration.
    pub(super) fn scan(config: &DatasetConfig, dir: &Path) -> Result<Self> {
        // The records come first, because a process that completes the dataset removes them after writing `dataset.json`.
        let records = ShardRecord::all(dir)?.into_iter().map(|record| (record.file.path.clone(), record));
        let records = records.collect();
        let info = match DatasetInfo::read(dir) {
            Ok(info) => Some(info),
            Err(Error::Incomplete { .. }) => None,
            // A damaged manifest can be written again if the folder has its configuration.
            Err(Error::Damaged { .. }) if config_file::read(dir)?.is_some() => None,
            Err(error) => return Err(error),
        };
        Ok(Self { config_digest: config_digest(config)?, info, records })
    }

    /// Fails if there are files of another configuration or version, or stray files.
    pub(super) fn refuse_foreign(&self, config: &DatasetConfig, dir: &Path) -> Result<()> {
        if self.info.is_none() {
            config_file::refuse_other(config, dir)?;
        }
        let manifest = self.info.iter().map(|info| (dir.join(info::FILE_NAME), info.config_digest.as_str()));
        let shards =
            self.records.values().map(|record| (dir.join(&record.file.path), record.config_digest.as_str()));
        for (path, found) in manifest.chain(shards) {
            if found != self.config_digest {
                let (found, expected) = (found.to_owned(), self.config_digest.clone());
                return Err(Error::OtherConfig { path, found, expected });
            }
        }
        let mut versions = self.records.values().map(|record| &record.version);
        if let Some(found) = versions.find(|&version| version != env!("CARGO_PKG_VERSION")) {
            return Err(Error::OtherVersion { dir: dir.to_owned(), found: found.clone() });
        }
        match stray_files(config, dir)?.first() {
            Some(path) => Err(Error::Stray { path: dir.join(path) }),
            None => Ok(()),
        }
    }

    /// Compares the file of a shard with its record, or with the manifest; reads the whole file.
    pub(super) fn check(&self, shard: &Shard, dir: &Path) -> Result<FileRecord, DefectKind> {
        let path = shard.path();
        if let Some(record) = self.records.get(&path) {
            return match record.defect(&self.config_digest, dir) {
                None => Ok(record.file.clone()),
                Some(defect) => Err(defect),
            };
        }
        let manifest = self.info.iter().filter(|info| info.config_digest == self.config_digest);
        match manifest.flat_map(|info| &info.files).find(|file| file.path == path) {
            Some(file) => file.defect(dir).map_or_else(|| Ok(file.clone()), Err),
            None if dir.join(path).exists() => Err(DefectKind::Unrecorded),
            None => Err(DefectKind::Missing),
        }
    }
}

/// Lists Parquet files that are not part of the dataset, by their path below its folder.
pub(super) fn stray_files(config: &DatasetConfig, dir: &Path) -> Result<Vec<String>> {
    let data = dir.join("data");
    let entries = match std::fs::read_dir(&data) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        found => found.map_err(Error::io(&data))?,
    };
    let mut strays = Vec::new();
    for entry in entries {
        let name = entry.map_err(Error::io(&data))?.file_name().to_string_lossy().into_owned();
        if name.ends_with(".parquet") {
            strays.push(format!("data/{name}"));
        }
    }
    let shards: BTreeSet<_> = Shard::all(config).iter().map(Shard::path).collect();
    strays.retain(|path| !shards.contains(path));
    strays.sort();
    Ok(strays)
}
