//! Makes a dataset, or what is missing of it.

use crate::config::DatasetConfig;
use crate::earlier::Earlier;
use crate::error::{Error, Result};
use crate::example::Collector;
use crate::finish::complete;
use crate::info::FileRecord;
use crate::part::Part;
use crate::progress::{Options, Progress, Run};
use crate::publish::io;
use crate::queue::in_order;
use crate::recipe;
use crate::shard::Shard;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
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

/// What was made of a part.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PartSummary {
    /// Files of the part.
    pub files: u64,
    /// Rows of the part.
    pub rows: u64,
    /// Rows made by this run.
    pub rows_made: u64,
}

/// Makes the dataset of a configuration in a folder, with as many threads as the current rayon pool has.
///
/// Files that an earlier run finished stay, if they are as it left them; a complete dataset stays as it is. A folder with a
/// dataset of another configuration is refused.
pub fn generate(
    config: &DatasetConfig,
    out: &Path,
    options: &Options<'_>,
    progress: &dyn Fn(Progress),
) -> Result<Summary> {
    let collector = Collector::new(config)?;
    let shards = Shard::all(config);
    let mut run = Run::new(&shards, options, progress);
    let (earlier, files) = make(&collector, &shards, out, &mut run)?;
    let info = complete(config, out, files, &earlier)?.info;
    let (rows, images, rows_made) = (info.rows, info.images, run.progress.rows_made);
    Ok(Summary { rows, images, rows_made, digest: info.digest })
}

/// Makes a part of a dataset. [`crate::finish()`], or [`generate`], completes it when all parts are there: made in one folder,
/// also at the same time, or in several that are copied together.
pub fn generate_part(
    config: &DatasetConfig,
    part: Part,
    out: &Path,
    options: &Options<'_>,
    progress: &dyn Fn(Progress),
) -> Result<PartSummary> {
    let collector = Collector::new(config)?;
    let shards = Shard::of_part(config, part);
    let mut run = Run::new(&shards, options, progress);
    let (_, files) = make(&collector, &shards, out, &mut run)?;
    let Progress { rows_made, rows_total: rows, .. } = run.progress;
    Ok(PartSummary { files: files.len() as u64, rows, rows_made })
}

/// Makes those of the files that are not there.
fn make(
    collector: &Collector<'_>,
    shards: &[Shard],
    out: &Path,
    run: &mut Run<'_>,
) -> Result<(Earlier, Vec<FileRecord>)> {
    let config = collector.config();
    let earlier = Earlier::find(config, out)?;
    earlier.refuse_others(config, out)?;
    if earlier.info.is_none() {
        recipe::claim(config, out)?;
    }
    let data = out.join("data");
    std::fs::create_dir_all(&data).map_err(|source| io(&data, source))?;
    let found: Vec<_> = shards.par_iter().map(|shard| earlier.file(shard, out).ok()).collect();
    found.iter().flatten().for_each(|file| run.found(file));
    let missing = shards.iter().zip(&found).filter(|(_, file)| file.is_none()).map(|(shard, _)| shard);
    // Rows are made across the ends of files, while this thread writes.
    let made: Result<Vec<_>> = in_order(
        missing.clone().flat_map(Shard::batches),
        |rows| rows.map(|row| collector.example(row)).collect::<Vec<_>>(),
        |batches| {
            let examples = &mut batches.flatten();
            missing.clone().map(|shard| shard.write(collector, out, examples, run)).collect()
        },
    );
    if let Err(Error::Example { .. }) = made {
        recipe::give_up(out)?;
    }
    let made = made?;
    let mut made = made.into_iter();
    let files = found.into_iter().filter_map(|file| file.or_else(|| made.next()));
    Ok((earlier, files.collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finish::finish;
    use crate::info::config_digest;
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
            assert_eq!(made[0].len(), 6, "three shards, card, config.toml and dataset.json");
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
        for name in ["dataset.json", "config.toml"] {
            fs::remove_file(dir.path().join(name)).unwrap();
        }
        let error = make(&config("a", 4), dir.path()).unwrap_err().to_string();
        assert!(error.contains("train-00000-of-00001.parquet does not belong to this dataset"), "{error}");
    }

    /// Generates a part without being watched.
    fn make_part(part: &str, dir: &Path) -> PartSummary {
        let options = Options { stop: &AtomicBool::new(false) };
        generate_part(&config("a", 19), part.parse().unwrap(), dir, &options, &|_| {}).unwrap()
    }

    #[test]
    fn parts_in_any_mix_give_what_one_machine_gives() {
        let [whole, parts, other] = [0, 1, 2].map(|_| tempfile::tempdir().unwrap());
        make(&config("a", 19), whole.path()).unwrap();
        assert_eq!(make_part("2/4", parts.path()), PartSummary { files: 2, rows: 6, rows_made: 6 });
        let missing = finish(parts.path()).unwrap_err().to_string();
        assert!(missing.contains("2 of 7 files are there"), "{missing}");
        for (i, part) in [(0, "1/7"), (2, "3/7"), (3, "4/7"), (4, "5/7"), (6, "7/7")] {
            let line = format!("data/train-{i:05}-of-00007.parquet: missing (--shard {part})");
            assert!(missing.contains(&line), "{line} in {missing}");
        }
        // Another machine, whose folder is copied over.
        make_part("1/2", other.path());
        for (path, bytes) in files(other.path()) {
            fs::write(parts.path().join(path), bytes).unwrap();
        }
        assert_eq!(make_part("4/4", parts.path()).rows_made, 3);
        assert_eq!(make_part("2/2", parts.path()), PartSummary { files: 3, rows: 9, rows_made: 0 });
        let finished = finish(parts.path()).unwrap();
        assert!(!finished.before && finished.info.rows == 19);
        assert!(files(parts.path()) == files(whole.path()));
        assert!(finish(parts.path()).unwrap().before);
        assert!(files(parts.path()) == files(whole.path()));
    }

    #[test]
    fn what_is_missing_damaged_or_of_another_configuration_is_named() {
        let [dir, other] = [0, 1].map(|_| tempfile::tempdir().unwrap());
        make_part("1/1", dir.path());
        let path = |i: usize| format!("data/train-{i:05}-of-00007.parquet");
        let record = |i: usize| format!("shards/train-{i:05}-of-00007.json");
        fs::remove_file(dir.path().join(path(0))).unwrap();
        let mut bytes = fs::read(dir.path().join(path(1))).unwrap();
        bytes[100] ^= 1;
        fs::write(dir.path().join(path(1)), bytes).unwrap();
        fs::write(dir.path().join(record(2)), "{\"config_digest\": \"0123").unwrap();
        let options = Options { stop: &AtomicBool::new(false) };
        let seeded = DatasetConfig { seed: 9, ..config("a", 19) };
        generate_part(&seeded, Part::WHOLE, other.path(), &options, &|_| {}).unwrap();
        for name in [path(3), record(3)] {
            fs::copy(other.path().join(&name), dir.path().join(&name)).unwrap();
        }
        let error = finish(dir.path()).unwrap_err().to_string();
        for line in [
            format!("{}: missing (--shard 1/7)", path(0)),
            format!("{}: expected SHA-256", path(1)),
            format!("{}: there without its record", path(2)),
            format!("{}: of another configuration (digest {}", path(3), config_digest(&seeded).unwrap()),
        ] {
            assert!(error.contains(&line), "{line} in {error}");
        }
        let refused = make(&config("a", 19), dir.path()).unwrap_err();
        assert!(matches!(&refused, Error::OtherConfig { path: other, .. } if other.ends_with(path(3))));
        fs::remove_file(dir.path().join(record(3))).unwrap();
        assert_eq!(make(&config("a", 19), dir.path()).unwrap().rows_made, 12);
    }

    #[test]
    fn an_incomplete_folder_says_how_far_it_is_and_how_to_go_on() {
        let dir = tempfile::tempdir().unwrap();
        let error = || DatasetReader::open(dir.path()).unwrap_err().to_string();
        assert!(error().contains("holds no complete dataset"), "{}", error());
        make_part("1/2", dir.path());
        let again = format!("dataset generate {0}/config.toml --out {0}", dir.path().display());
        assert!(error().contains("4 of 7 files are finished") && error().contains(&again), "{}", error());
        make_part("2/2", dir.path());
        assert!(error().contains("dataset finish"), "{}", error());
    }

    #[test]
    fn a_configuration_that_makes_no_rows_does_not_keep_the_folder() {
        let dir = tempfile::tempdir().unwrap();
        let mut nowhere = config("a", 4);
        (nowhere.target.x_mm, nowhere.rejection.tries) = ([900.0, 900.0], 20);
        assert!(matches!(make(&nowhere, dir.path()), Err(Error::Example { index: 0, .. })));
        make(&config("a", 4), dir.path()).unwrap();
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
        assert!(
            matches!(
                error,
                Error::Interrupted { rows_done: 6, rows_total: 7, files_done: 2, files_total: 3 }
            ),
            "{error}"
        );
        assert!(matches!(DatasetReader::open(stopped.path()), Err(Error::Incomplete { .. })));
        assert!(!files(stopped.path()).keys().any(|path| path.contains("partial")));
        assert_eq!(make(&config, stopped.path()).unwrap().rows_made, 1);
        assert_eq!(heard.into_inner(), [3, 6]);
        make(&config, whole.path()).unwrap();
        assert!(files(stopped.path()) == files(whole.path()));
    }
}
