//! What earlier runs, here or on other machines, left of a dataset in its folder.

use crate::config::DatasetConfig;
use crate::error::{Error, Result};
use crate::fault::Problem;
use crate::info::{DatasetInfo, FileRecord, config_digest};
use crate::publish::io;
use crate::recipe;
use crate::record::ShardRecord;
use crate::shard::Shard;
use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::Path;

/// What earlier runs left.
pub(crate) struct Earlier {
    config_digest: String,
    pub(crate) info: Option<DatasetInfo>,
    records: BTreeMap<String, ShardRecord>,
}

impl Earlier {
    /// Looks into a folder, for the dataset of a configuration.
    pub(crate) fn find(config: &DatasetConfig, dir: &Path) -> Result<Self> {
        // Records first: a process that completes the dataset removes them after it has written `dataset.json`.
        let records = ShardRecord::all(dir)?.into_iter().map(|record| (record.file.path.clone(), record));
        let records = records.collect();
        let info = match DatasetInfo::read(dir) {
            Ok(info) => Some(info),
            Err(Error::Incomplete { .. }) => None,
            // It can be made again if the folder says of what it is.
            Err(Error::Damaged { .. }) if recipe::read(dir)?.is_some() => None,
            Err(error) => return Err(error),
        };
        Ok(Self { config_digest: config_digest(config)?, info, records })
    }

    /// Refuses what was left by another configuration, or by another version of flowservo.
    pub(crate) fn refuse_others(&self, config: &DatasetConfig, dir: &Path) -> Result<()> {
        if self.info.is_none() {
            recipe::refuse_other(config, dir)?;
        }
        let described =
            self.info.iter().map(|info| (dir.join(crate::info::FILE_NAME), info.config_digest.as_str()));
        let recorded =
            self.records.values().map(|record| (dir.join(&record.file.path), record.config_digest.as_str()));
        for (path, found) in described.chain(recorded) {
            if found != self.config_digest {
                let (found, wanted) = (found.to_owned(), self.config_digest.clone());
                return Err(Error::OtherConfig { path, found, wanted });
            }
        }
        let mut versions = self.records.values().map(|record| &record.version);
        if let Some(found) = versions.find(|&version| version != env!("CARGO_PKG_VERSION")) {
            return Err(Error::OtherVersion { dir: dir.to_owned(), found: found.clone() });
        }
        match strays(config, dir)?.first() {
            Some(path) => Err(Error::Stray { path: dir.join(path) }),
            None => Ok(()),
        }
    }

    /// The file of a shard if it is there as recorded, or what is wrong; reads it.
    pub(crate) fn file(&self, shard: &Shard, dir: &Path) -> Result<FileRecord, Problem> {
        let path = shard.path();
        if let Some(record) = self.records.get(&path) {
            return match record.problem(&self.config_digest, dir) {
                None => Ok(record.file.clone()),
                Some(problem) => Err(problem),
            };
        }
        let described = self.info.iter().filter(|info| info.config_digest == self.config_digest);
        match described.flat_map(|info| &info.files).find(|file| file.path == path) {
            Some(file) => file.problem(dir).map_or_else(|| Ok(file.clone()), Err),
            None if dir.join(path).exists() => Err(Problem::Unrecorded),
            None => Err(Problem::Missing),
        }
    }
}

/// Parquet files that are none of the dataset's, by their path below its folder.
pub(crate) fn strays(config: &DatasetConfig, dir: &Path) -> Result<Vec<String>> {
    let data = dir.join("data");
    let entries = match std::fs::read_dir(&data) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        found => found.map_err(|source| io(&data, source))?,
    };
    let mut strays = Vec::new();
    for entry in entries {
        let name = entry.map_err(|source| io(&data, source))?.file_name().to_string_lossy().into_owned();
        if name.ends_with(".parquet") {
            strays.push(format!("data/{name}"));
        }
    }
    let shards: BTreeSet<_> = Shard::all(config).iter().map(Shard::path).collect();
    strays.retain(|path| !shards.contains(path));
    strays.sort();
    Ok(strays)
}
