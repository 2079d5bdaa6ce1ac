//! How far the making of a dataset is, and whether it should go on.

use crate::error::{Error, Result};
use crate::example::Example;
use crate::info::FileRecord;
use crate::shard::Shard;
use std::sync::atomic::{AtomicBool, Ordering};

/// How a dataset is made; nothing here changes its bytes.
#[derive(Debug, Clone, Copy)]
pub struct Options<'a> {
    /// Set by another thread to stop before the next row.
    pub stop: &'a AtomicBool,
}

/// How far the work is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Rows that are there, those of earlier runs included.
    pub rows_done: u64,
    /// Rows made by this run.
    pub rows_made: u64,
    /// Rows asked for.
    pub rows_total: u64,
}

/// One run's progress and its audience.
pub(crate) struct Run<'a> {
    options: &'a Options<'a>,
    report: &'a dyn Fn(Progress),
    pub(crate) progress: Progress,
    files_done: u64,
    files_total: u64,
}

impl<'a> Run<'a> {
    /// A run that is to make these files.
    pub(crate) fn new(shards: &[Shard], options: &'a Options<'a>, report: &'a dyn Fn(Progress)) -> Self {
        let rows_total = shards.iter().map(|shard| shard.rows.end - shard.rows.start).sum();
        let progress = Progress { rows_done: 0, rows_made: 0, rows_total };
        Self { options, report, progress, files_done: 0, files_total: shards.len() as u64 }
    }

    /// A file of an earlier run was found.
    pub(crate) fn found(&mut self, file: &FileRecord) {
        self.files_done += 1;
        self.done(file.rows);
    }

    /// Rows were made.
    pub(crate) fn made(&mut self, rows: u64) {
        self.progress.rows_made += rows;
        self.done(rows);
    }

    /// A file was made.
    pub(crate) fn finished(&mut self) {
        self.files_done += 1;
    }

    /// The next example, or an error if the work should stop.
    pub(crate) fn take(&self, examples: &mut dyn Iterator<Item = Result<Example>>) -> Result<Example> {
        let example = if self.options.stop.load(Ordering::Relaxed) { None } else { examples.next() };
        let Progress { rows_done, rows_total, .. } = self.progress;
        let Self { files_done, files_total, .. } = *self;
        example.unwrap_or(Err(Error::Interrupted { rows_done, rows_total, files_done, files_total }))
    }

    fn done(&mut self, rows: u64) {
        self.progress.rows_done += rows;
        (self.report)(self.progress);
    }
}
