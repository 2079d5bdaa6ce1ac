//! `metrics.jsonl`: one line an epoch.

use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use crate::error::Result;
use crate::fit::EpochRecord;
use crate::publish::{self, at};

fn file(run: &Path) -> PathBuf {
    run.join("metrics.jsonl")
}

/// The epochs of a run so far. A line that a crash cut off ends them.
pub fn read(run: &Path) -> Result<Vec<EpochRecord>> {
    let text = match fs::read_to_string(file(run)) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        text => text.map_err(at(&file(run)))?,
    };
    Ok(text.lines().map_while(|line| serde_json::from_str(line).ok()).collect())
}

/// Appends an epoch.
pub(crate) fn append(run: &Path, record: &EpochRecord) -> Result<()> {
    let path = file(run);
    let opened = OpenOptions::new().create(true).append(true).open(&path);
    opened.and_then(|mut file| file.write_all(line(record).as_bytes())).map_err(at(&path))
}

/// Forgets the epochs after the first `epochs`, which are about to be repeated.
pub(crate) fn keep(run: &Path, epochs: usize) -> Result<()> {
    let kept = read(run)?.into_iter().filter(|record| record.epoch <= epochs);
    publish::write(&file(run), &kept.map(|record| line(&record)).collect::<String>())
}

fn line(record: &EpochRecord) -> String {
    let text = serde_json::to_string(record).expect("numbers under names are always JSON");
    text + "\n"
}
