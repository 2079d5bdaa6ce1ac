//! Completes a dataset whose files are all there, whoever made them.

use crate::config::DatasetConfig;
use crate::earlier::Earlier;
use crate::error::{Error, Result};
use crate::fault::Fault;
use crate::info::{DatasetInfo, FileRecord};
use crate::part::Part;
use crate::shard::Shard;
use crate::{recipe, record};
use rayon::iter::{IndexedParallelIterator, IntoParallelRefIterator, ParallelIterator};
use std::path::Path;

/// A dataset that is complete.
#[derive(Debug, Clone, PartialEq)]
pub struct Finished {
    /// What it is made of.
    pub info: DatasetInfo,
    /// It was complete before.
    pub before: bool,
}

/// Checks every file of a folder against its record, and writes what one machine would have written: card and
/// `dataset.json`. Names all files that are missing, damaged, or of another configuration.
pub fn finish(dir: &Path) -> Result<Finished> {
    let config = match DatasetInfo::read(dir) {
        Ok(info) => info.config,
        Err(_) => recipe::read(dir)?.ok_or_else(|| Error::Incomplete { dir: dir.to_owned(), files: None })?,
    };
    config.validate()?;
    let earlier = Earlier::find(&config, dir)?;
    let shards = Shard::all(&config);
    let of = shards.len() as u64;
    let checked = shards.par_iter().enumerate().map(|(i, shard)| {
        // Each file is a part of its own.
        let part = Part::new(i as u64 + 1, of).unwrap_or(Part::WHOLE);
        earlier.file(shard, dir).map_err(|problem| (part, Fault { path: shard.path(), problem }))
    });
    let (mut files, mut missing) = (Vec::new(), Vec::new());
    for file in checked.collect::<Vec<_>>() {
        match file {
            Ok(file) => files.push(file),
            Err(fault) => missing.push(fault),
        }
    }
    if !missing.is_empty() {
        return Err(Error::Unfinished { dir: dir.to_owned(), of, missing });
    }
    earlier.refuse_others(&config, dir)?;
    complete(&config, dir, files, &earlier)
}

/// Publishes what belongs to these files, `dataset.json` last, unless it is there already.
pub(crate) fn complete(
    config: &DatasetConfig,
    dir: &Path,
    files: Vec<FileRecord>,
    earlier: &Earlier,
) -> Result<Finished> {
    let described = earlier.info.as_ref().filter(|info| info.files == files);
    let before = described.is_some_and(|info| info.document_faults(dir).is_empty());
    let info = match described {
        Some(info) if before => info.clone(),
        _ => {
            let info = DatasetInfo::new(config, files)?;
            info.publish(dir)?;
            info
        }
    };
    record::remove_all(dir)?;
    Ok(Finished { info, before })
}
