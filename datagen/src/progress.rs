//! How far the making of a dataset is, and whether it should go on.

use crate::error::{Error, Result};
use std::sync::atomic::{AtomicBool, Ordering};

/// How a dataset is made; nothing here changes its bytes.
#[derive(Debug, Clone, Copy)]
pub struct Options<'a> {
    /// Set by another thread to stop before the next group of rows.
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
}

impl<'a> Run<'a> {
    pub(crate) fn new(rows_total: u64, options: &'a Options<'a>, report: &'a dyn Fn(Progress)) -> Self {
        Self { options, report, progress: Progress { rows_done: 0, rows_made: 0, rows_total } }
    }

    /// Rows of an earlier run were found.
    pub(crate) fn found(&mut self, rows: u64) {
        self.progress.rows_done += rows;
        (self.report)(self.progress);
    }

    /// Rows were made.
    pub(crate) fn made(&mut self, rows: u64) {
        self.progress.rows_made += rows;
        self.found(rows);
    }

    /// An error if the work should stop.
    pub(crate) fn check(&self) -> Result<()> {
        let Progress { rows_done, rows_total, .. } = self.progress;
        if self.options.stop.load(Ordering::Relaxed) {
            return Err(Error::Interrupted { rows_done, rows_total });
        }
        Ok(())
    }
}
