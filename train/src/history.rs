//! `metrics.jsonl`: one line an epoch.

use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::error::Result;
use crate::metric::Metrics;
use crate::publish::{self, at};

/// What an epoch achieved: a function of configuration and data.
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
    /// Mean loss of the epoch's batches, each before its step.
    pub training_loss: f64,
    /// Greatest norm of a gradient in the epoch, before clipping.
    pub gradient_norm: f64,
    /// On the validation set, after the epoch.
    #[serde(flatten)]
    pub validation: Metrics,
}

/// What an epoch cost: no two runs have the same, so it is in no checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(crate) struct Cost {
    /// Since this run was started or resumed, with validation \[s\].
    pub(crate) seconds: f64,
    /// Training examples a second, without validation; none if the run was resumed after the epoch's last step.
    pub(crate) samples_per_s: Option<f64>,
    /// Largest memory of the process so far; none where the system does not tell.
    pub(crate) peak_memory_mb: Option<f64>,
}

/// A line.
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

/// The epochs of a run so far. A line that a crash cut off ends them.
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

/// Appends an epoch.
pub(crate) fn append(run: &Path, line: &Line) -> Result<()> {
    let path = file(run);
    let text = serde_json::to_string(line).expect("numbers under names are always JSON") + "\n";
    let write = || {
        let mut file = OpenOptions::new().create(true).append(true).open(&path)?;
        file.write_all(text.as_bytes())?;
        file.sync_data()
    };
    write().map_err(at(&path))
}

/// Forgets the epochs after the first `epochs`, which are about to be repeated.
pub(crate) fn keep(run: &Path, epochs: usize) -> Result<()> {
    let text = text(run)?;
    let kept = lines(&text).filter(|(record, _)| record.epoch <= epochs);
    publish::write(&file(run), &kept.flat_map(|(_, line)| [line, "\n"]).collect::<String>())
}
