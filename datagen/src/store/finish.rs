//! Completes a dataset whose shards are all finished, on one machine or on several.

use super::existing_files::ExistingFiles;
use super::file_record::FileRecord;
use super::info::{self, DatasetInfo};
use super::shard::Shard;
use super::{card, config_file, json, shard_record};
use crate::config::DatasetConfig;
use crate::defect::Defect;
use crate::digest::digest;
use crate::error::{Error, Result};
use crate::publish::publish;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::Path;

/// A completed dataset.
#[derive(Debug, Clone, PartialEq)]
pub struct Finished {
    /// Manifest of the dataset.
    pub info: DatasetInfo,
    /// Whether it was complete before.
    pub was_complete: bool,
}

/// Completes a dataset: checks every file against its record, and publishes the card and `dataset.json`.
///
/// The files are the same as if one machine had generated all shards. An error lists all shards that are missing, damaged or
/// foreign.
pub fn finish(dir: &Path) -> Result<Finished> {
    let config = match DatasetInfo::read(dir) {
        Ok(info) => info.config,
        Err(_) => {
            config_file::read(dir)?.ok_or_else(|| Error::Incomplete { dir: dir.to_owned(), files: None })?
        }
    };
    config.validate()?;
    let existing = ExistingFiles::scan(&config, dir)?;
    let shards = Shard::all(&config);
    let checked: Vec<_> = shards.par_iter().map(|shard| existing.check(shard, dir)).collect();
    let (mut files, mut missing) = (Vec::new(), Vec::new());
    for ((number, shard), checked) in (1..).zip(&shards).zip(checked) {
        match checked {
            Ok(file) => files.push(file),
            Err(kind) => missing.push((number, Defect { path: shard.path(), kind })),
        }
    }
    if !missing.is_empty() {
        return Err(Error::Unfinished { dir: dir.to_owned(), files: shards.len() as u64, missing });
    }
    existing.refuse_foreign(&config, dir)?;
    complete(&config, dir, files, &existing)
}

/// Publishes card and `dataset.json` for finished files, unless they are there already, and removes the records.
pub(super) fn complete(
    config: &DatasetConfig,
    dir: &Path,
    files: Vec<FileRecord>,
    existing: &ExistingFiles,
) -> Result<Finished> {
    let manifest = existing.info.as_ref().filter(|info| info.files == files);
    let intact = manifest.filter(|info| info.document_defects(dir).is_empty());
    let info = match intact {
        Some(info) => info.clone(),
        None => publish_manifest(config, dir, files)?,
    };
    shard_record::remove_all(dir)?;
    Ok(Finished { info, was_complete: intact.is_some() })
}

/// Publishes card and configuration, and then `dataset.json`.
pub(crate) fn publish_manifest(
    config: &DatasetConfig,
    dir: &Path,
    files: Vec<FileRecord>,
) -> Result<DatasetInfo> {
    let mut info = describe(config, files)?;
    let documents =
        [(card::FILE_NAME, card::text(&info)), (config_file::FILE_NAME, config_file::text(config)?)];
    let digests = documents.iter().map(|(name, text)| ((*name).to_owned(), digest(text.as_bytes())));
    info.documents = digests.collect();
    info.seal = info.compute_seal()?;
    for (name, text) in documents {
        let path = dir.join(name);
        publish(&path, |file| file.write_all(text.as_bytes()).map_err(Error::io(&path)))?;
    }
    json::write(&dir.join(info::FILE_NAME), &info)?;
    Ok(info)
}

/// Describes files in the order of their rows, without the digests of the documents and the seal.
fn describe(config: &DatasetConfig, files: Vec<FileRecord>) -> Result<DatasetInfo> {
    let images_per_row = config.motions[0].ranges().count() as u64;
    let lines: Vec<String> = files.iter().map(|file| format!("{}  {}\n", file.sha256, file.path)).collect();
    Ok(DatasetInfo {
        name: config.name.clone(),
        rows: config.count,
        images: config.count * images_per_row,
        digest: digest(lines.concat().as_bytes()),
        config_digest: config_file::config_digest(config)?,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        files,
        documents: BTreeMap::new(),
        config: config.clone(),
        seal: String::new(),
    })
}
