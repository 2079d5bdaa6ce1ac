//! Makes a dataset, or what is missing of it.

use crate::card;
use crate::config::DatasetConfig;
use crate::error::{Error, Result};
use crate::example::Collector;
use crate::info::{DatasetInfo, FileRecord, config_digest};
use crate::progress::{Options, Progress, Run};
use crate::publish::io;
use crate::shard::{RECORDS, Shard, ShardRecord};
use std::path::Path;

/// What was made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Summary {
    /// Rows of the dataset.
    pub rows: u64,
    /// Images of the dataset.
    pub images: u64,
    /// Rows made by this run: fewer where an earlier one had finished files, none where it had finished all.
    pub rows_made: u64,
    /// Digest of the dataset.
    pub digest: String,
}

/// Makes the dataset of a configuration in a folder, with the threads of the current rayon pool.
///
/// Files that an earlier run finished stay; a complete dataset stays as it is. A folder with a dataset of another
/// configuration is refused.
pub fn generate(
    config: &DatasetConfig,
    out: &Path,
    options: &Options<'_>,
    progress: &dyn Fn(Progress),
) -> Result<Summary> {
    let collector = Collector::new(config)?;
    let earlier = Earlier::find(config, out)?;
    if let Some(info) = earlier.info.as_ref().filter(|info| info.check_sizes(out).is_ok()) {
        return Ok(summary(info, 0));
    }
    for folder in ["data", RECORDS] {
        let folder = out.join(folder);
        std::fs::create_dir_all(&folder).map_err(|source| io(&folder, source))?;
    }
    let mut run = Run::new(config.count, options, progress);
    let mut files = Vec::new();
    for shard in Shard::all(config) {
        let file = match earlier.file(&shard, out) {
            Some(file) => {
                run.found(file.rows);
                file
            }
            None => shard.write(&collector, out, &earlier.config_digest, &mut run)?,
        };
        files.push(file);
    }
    let info = finish(config, out, files)?;
    Ok(summary(&info, run.progress.rows_made))
}

/// Publishes the card and `dataset.json`.
fn finish(config: &DatasetConfig, out: &Path, files: Vec<FileRecord>) -> Result<DatasetInfo> {
    let info = DatasetInfo::new(config, files)?;
    card::write(&info, out)?;
    info.write(out)?;
    let records = out.join(RECORDS);
    std::fs::remove_dir_all(&records).map_err(|source| io(&records, source))?;
    Ok(info)
}

/// What earlier runs of the same configuration left.
struct Earlier {
    config_digest: String,
    info: Option<DatasetInfo>,
    records: Vec<ShardRecord>,
}

impl Earlier {
    /// Refuses what runs of another configuration left.
    fn find(config: &DatasetConfig, out: &Path) -> Result<Self> {
        let info = match DatasetInfo::read(out) {
            Ok(info) => Some(info),
            Err(Error::Incomplete { .. }) => None,
            Err(error) => return Err(error),
        };
        let earlier = Self { config_digest: config_digest(config)?, info, records: ShardRecord::all(out)? };
        let digests = earlier.records.iter().map(|record| &record.config_digest);
        for found in digests.chain(earlier.info.iter().map(|info| &info.config_digest)) {
            if *found != earlier.config_digest {
                let (found, wanted) = (found.clone(), earlier.config_digest);
                return Err(Error::OtherConfig { dir: out.to_owned(), found, wanted });
            }
        }
        refuse_strays(config, out)?;
        Ok(earlier)
    }

    /// The file of a shard, if it is there as recorded.
    fn file(&self, shard: &Shard, out: &Path) -> Option<FileRecord> {
        let recorded = self.records.iter().map(|record| &record.file);
        let mut recorded = recorded.chain(self.info.iter().flat_map(|info| &info.files));
        recorded.find(|file| file.path == shard.path() && file.verify(out).is_ok()).cloned()
    }
}

/// Refuses Parquet files that the dataset would not overwrite.
fn refuse_strays(config: &DatasetConfig, out: &Path) -> Result<()> {
    let data = out.join("data");
    if !data.exists() {
        return Ok(());
    }
    let shards: Vec<_> = Shard::all(config).iter().map(|shard| out.join(shard.path())).collect();
    for entry in std::fs::read_dir(&data).map_err(|source| io(&data, source))? {
        let path = entry.map_err(|source| io(&data, source))?.path();
        let is_parquet = path.extension().is_some_and(|extension| extension == "parquet");
        if is_parquet && !shards.contains(&path) {
            return Err(Error::Stray { path });
        }
    }
    Ok(())
}

fn summary(info: &DatasetInfo, rows_made: u64) -> Summary {
    Summary { rows: info.rows, images: info.images, rows_made, digest: info.digest.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reader::DatasetReader;
    use crate::row::{ImagesRow, Row, SceneRow};
    use crate::tiny::{config, make};
    use std::cell::RefCell;
    use std::collections::BTreeMap;
    use std::fs;
    use std::sync::atomic::{AtomicBool, Ordering};

    /// All files of a folder, by path.
    fn files(dir: &Path) -> BTreeMap<String, Vec<u8>> {
        let mut found = BTreeMap::new();
        let mut folders = vec![dir.to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    found.insert(
                        path.strip_prefix(dir).unwrap().display().to_string(),
                        fs::read(path).unwrap(),
                    );
                }
            }
        }
        found
    }

    fn rows<R: Row>(dir: &Path) -> Vec<R> {
        DatasetReader::open(dir).unwrap().all().unwrap().collect::<Result<_>>().unwrap()
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bytes() {
        for name in ["c", "avoid"] {
            let made = [1, 2].map(|threads| {
                let dir = tempfile::tempdir().unwrap();
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| make(&config(name, 7), dir.path())).unwrap();
                files(dir.path())
            });
            assert_eq!(made[0].len(), 5, "three shards, card and dataset.json");
            assert!(made[0] == made[1], "{name}");
        }
    }

    #[test]
    fn a_row_depends_on_its_index_alone() {
        let dirs = [3, 6].map(|count| {
            let dir = tempfile::tempdir().unwrap();
            make(&config("a", count), dir.path()).unwrap();
            dir
        });
        let [few, many] = dirs.each_ref().map(|dir| rows::<ImagesRow>(dir.path()));
        assert_eq!(few, many[..3]);
        let [few, many] = dirs.each_ref().map(|dir| rows::<SceneRow>(dir.path()));
        assert_eq!(few, many[..3]);
        assert_ne!(many[0].scene, many[3].scene);
    }

    #[test]
    fn a_complete_dataset_stays_and_a_damaged_one_is_repaired() {
        let (dir, config) = (tempfile::tempdir().unwrap(), config("b", 7));
        let summary = make(&config, dir.path()).unwrap();
        assert_eq!((summary.rows, summary.images, summary.rows_made), (7, 14, 7));
        let complete = files(dir.path());
        assert_eq!(make(&config, dir.path()).unwrap(), Summary { rows_made: 0, ..summary.clone() });
        fs::write(dir.path().join("data/train-00001-of-00003.parquet"), "cut short").unwrap();
        assert_eq!(make(&config, dir.path()).unwrap(), Summary { rows_made: 3, ..summary });
        assert!(files(dir.path()) == complete);
    }

    #[test]
    fn another_configuration_is_refused_with_both_digests() {
        let dir = tempfile::tempdir().unwrap();
        make(&config("a", 1), dir.path()).unwrap();
        let error = make(&config("a", 2), dir.path()).unwrap_err().to_string();
        for count in [1, 2] {
            assert!(error.contains(&config_digest(&config("a", count)).unwrap()), "{error}");
        }
    }

    #[test]
    fn rows_of_another_dataset_are_not_mixed_in() {
        let dir = tempfile::tempdir().unwrap();
        make(&config("a", 1), dir.path()).unwrap();
        fs::remove_file(dir.path().join("dataset.json")).unwrap();
        let error = make(&config("a", 4), dir.path()).unwrap_err().to_string();
        assert!(error.contains("train-00000-of-00001.parquet does not belong to this dataset"), "{error}");
    }

    #[test]
    fn a_stopped_run_is_continued_and_ends_with_the_same_bytes() {
        let [stopped, whole] = [0, 1].map(|_| tempfile::tempdir().unwrap());
        let (config, stop) = (config("a", 7), AtomicBool::new(false));
        let heard = RefCell::new(Vec::new());
        let listen = |progress: Progress| {
            heard.borrow_mut().push(progress.rows_done);
            stop.store(progress.rows_done == 6, Ordering::Relaxed);
        };
        let error = generate(&config, stopped.path(), &Options { stop: &stop }, &listen).unwrap_err();
        assert!(matches!(error, Error::Interrupted { rows_done: 6, rows_total: 7 }), "{error}");
        assert!(matches!(DatasetReader::open(stopped.path()), Err(Error::Incomplete { .. })));
        assert!(!files(stopped.path()).keys().any(|path| path.contains("partial")));
        assert_eq!(make(&config, stopped.path()).unwrap().rows_made, 1);
        assert_eq!(heard.into_inner(), [3, 6]);
        make(&config, whole.path()).unwrap();
        assert!(files(stopped.path()) == files(whole.path()));
    }
}
