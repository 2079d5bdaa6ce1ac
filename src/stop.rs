//! Ctrl-C: the first asks the work to stop at the next safe place, the second ends the program at once.

use crate::output::note;
use anyhow::{Context, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Raised by Ctrl-C, or by a request of the system to end.
#[derive(Clone, Default)]
pub(crate) struct Stop(Arc<AtomicBool>);

impl Stop {
    /// Listens from now on; once a program.
    pub(crate) fn listen() -> Result<Self> {
        let stop = Self::default();
        let raised = stop.clone();
        ctrlc::set_handler(move || {
            if raised.0.swap(true, Ordering::SeqCst) {
                std::process::exit(130);
            }
            note!("\nstopping at the next safe place; press Ctrl-C again to stop at once (nothing finished is lost)");
        })
        .context("Ctrl-C cannot be caught")?;
        Ok(stop)
    }

    /// Was it raised?
    pub(crate) fn is_raised(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }

    /// The flag that libraries look at.
    pub(crate) fn flag(&self) -> &AtomicBool {
        &self.0
    }
}
