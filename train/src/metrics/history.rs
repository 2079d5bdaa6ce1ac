//! `metrics.jsonl`: one line per epoch.

use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use datagen::publish::publish;
use serde::{Deserialize, Serialize};

use super::validation::Metrics;
use crate::error::{Result, at};

/// The results of an epoch: a function of configuration and data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpochRecord {
    /// Epoch of the run, from 1.
    pub epoch: usize,
    /// Phase, from 1.
    pub phase: usize,
    /// Steps since the start of the run.
    pub steps: usize,
    /// Learning rate of the last step.
    pub learning_rate: f64,
    /// Mean loss of the epoch's batches, each computed before its step.
    pub training_loss: f64,
    /// Largest gradient norm in the epoch, before clipping.
    pub gradient_norm: f64,
    /// Metrics on the validation set after the epoch.
    #[serde(flatten)]
    pub validation: Metrics,
}

/// Time and memory of an epoch. They differ from run to run and are therefore not stored in checkpoints.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Cost {
    /// Seconds since this run was started or resumed, including validation.
    pub(crate) seconds: f64,
    /// Training examples per second, without validation. `None` if the run was resumed after the epoch's last step.
    pub(crate) samples_per_s: Option<f64>,
    /// Peak memory of the process so far. `None` if the system does not report it.
    pub(crate) peak_memory_mb: Option<f64>,
}

/// A line of the file.
#[derive(Debug, Serialize)]
pub(crate) struct Line<'a> {
    #[serde(flatten)]
    pub(crate) record: &'a EpochRecord,
    #[serde(flatten)]
    pub(crate) cost: Cost,
}

fn file(run: &Path) -> PathBuf {
    run.join("metrics.jsonl")
}

/// Reads the complete epochs of a run. Stops at a line truncated by a crash.
pub fn read(run: &Path) -> Result<Vec<EpochRecord>> {
    let text = text(run)?;
    Ok(lines(&text).map(|(record, _)| record).collect())
}

fn text(run: &Path) -> Result<String> {
    match fs::read_to_string(file(run)) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(String::new()),
        text => text.map_err(at(&file(run))),
    }
}

fn lines(text: &str) -> impl Iterator<Item = (EpochRecord, &str)> {
    text.lines().map_while(|line| Some((serde_json::from_str(line).ok()?, line)))
}

/// Appends a line.
pub(crate) fn append(run: &Path, line: &Line) -> Result<()> {
    let path = file(run);
    let text = serde_json::to_string(line).expect("numbers and names are always JSON") + "\n";
    let write = || {
        let mut file = OpenOptions::new().create(true).append(true).open(&path)?;
        file.write_all(text.as_bytes())?;
        file.sync_data()
    };
    write().map_err(at(&path))
}

/// Removes all lines after the first `epochs` epochs, which are about to be repeated.
pub(crate) fn truncate(run: &Path, epochs: usize) -> Result<()> {
    let text = text(run)?;
    let kept = lines(&text).filter(|(record, _)| record.epoch <= epochs);
    let kept: String = kept.flat_map(|(_, line)| [line, "\n"]).collect();
    let path = file(run);
    publish(&path, |file| file.write_all(kept.as_bytes()).map_err(at(&path)))
}
