//! An evaluated system: one choice of policies.

use super::accuracy::{Accuracy, FinalError};
use super::outcomes::Outcomes;
use crate::session::record::SessionRecord;

/// A system's name, and the statistics of its sessions.
#[derive(Debug, Clone, PartialEq)]
pub struct System {
    /// Name in the tables.
    pub name: String,
    /// Final errors.
    pub accuracy: Accuracy,
    /// Outcomes, iterations and times.
    pub outcomes: Outcomes,
}

impl System {
    /// Computes the statistics of all sessions of a system.
    pub fn of(name: impl Into<String>, records: &[SessionRecord]) -> Self {
        let errors: Vec<FinalError> = records.iter().map(FinalError::from).collect();
        Self { name: name.into(), accuracy: Accuracy::of(&errors), outcomes: Outcomes::of(records) }
    }
}
