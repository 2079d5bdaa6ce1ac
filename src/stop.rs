//! Ctrl-C: the first asks the program to stop at the next safe point, the second ends it immediately.

use crate::output::note;
use anyhow::{Context, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A stop request, raised by Ctrl-C or a termination signal.
#[derive(Clone, Default)]
pub(crate) struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Starts to listen for Ctrl-C. May be called once per process.
    pub(crate) fn listen() -> Result<Self> {
        let stop = Self::default();
        let raised = stop.clone();
        ctrlc::set_handler(move || {
            if raised.0.swap(true, Ordering::SeqCst) {
                std::process::exit(130);
            }
            note!("\nstopping at the next safe point; press Ctrl-C again to stop immediately (finished work is kept)");
        })
        .context("cannot handle Ctrl-C")?;
        Ok(stop)
    }

    /// Returns whether a stop was requested.
    pub(crate) fn is_raised(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }

    /// Returns the flag for the libraries to poll.
    pub(crate) fn flag(&self) -> &AtomicBool {
        &self.0
    }
}
