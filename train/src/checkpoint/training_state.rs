//! The training state: everything besides weights and moments that a run needs to resume exactly.

use std::path::Path;

use burn_store::ModuleSnapshot;
use datagen::digest::digest_of_file;
use serde::{Deserialize, Serialize};

use super::files::{OPTIMIZER, TRAINING, cannot_write, invalid, read_json, store, verify, write_json};
use crate::error::Result;
use crate::metrics::history::EpochRecord;
use crate::metrics::loss_curve::LossCurve;
use crate::optimizer::adamw::AdamW;
use crate::optimizer::phase::Phase;

/// Position of a run in its plan, and the statistics so far.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TrainingState {
    /// Complete phases.
    pub(crate) phase: usize,
    /// Complete epochs of the current phase.
    pub(crate) phase_epoch: usize,
    /// Lowest validation loss of the current phase, and the number of epochs since.
    lowest: Option<(f64, usize)>,
    /// Complete epochs of the run.
    pub(crate) epoch: usize,
    /// Steps taken in the run.
    pub(crate) steps: usize,
    /// Steps taken in the current epoch.
    pub(crate) batch: usize,
    /// Sum of the losses of the current epoch.
    pub(crate) loss_sum: f64,
    /// Largest gradient norm of the current epoch.
    pub(crate) gradient_norm: f64,
    /// Training loss of the run.
    pub(crate) losses: LossCurve,
    /// Last complete epoch.
    pub(crate) last: Option<EpochRecord>,
    /// Complete epoch with the lowest validation loss of the run.
    pub(crate) best: Option<EpochRecord>,
}

/// Contents of `training.json`.
#[derive(Debug, Serialize, Deserialize)]
struct TrainingFile {
    #[serde(rename = "place")]
    state: TrainingState,
    optimizer_sha256: String,
}

impl TrainingState {
    /// Returns the steps taken in the current phase.
    pub(crate) fn phase_steps(&self, phase: &Phase) -> usize {
        self.phase_epoch * phase.batches + self.batch
    }

    /// Returns steps and epochs of the whole run, provided that no further phase stops early.
    pub(crate) fn planned(&self, phases: &[Phase]) -> [usize; 2] {
        let mut planned = [self.steps, self.epoch];
        for (index, phase) in phases.iter().enumerate().skip(self.phase) {
            let done = if index == self.phase { [self.phase_steps(phase), self.phase_epoch] } else { [0; 2] };
            planned[0] += phase.epochs * phase.batches - done[0];
            planned[1] += phase.epochs - done[1];
        }
        planned
    }

    /// Counts a step.
    pub(crate) fn step(&mut self, loss: f64, gradient_norm: f64) {
        self.steps += 1;
        self.batch += 1;
        self.loss_sum += loss;
        self.gradient_norm = self.gradient_norm.max(gradient_norm);
    }

    /// Completes an epoch, and the phase if it ends with it. Returns whether the epoch is the best so far.
    pub(crate) fn complete_epoch(&mut self, record: EpochRecord, phase: &Phase) -> bool {
        let loss = record.validation.loss();
        let is_best = self.best.as_ref().is_none_or(|best| loss < best.validation.loss());
        if is_best {
            self.best = Some(record.clone());
        }
        self.last = Some(record);
        let without_improvement = match &mut self.lowest {
            Some((lowest, age)) if loss >= *lowest => {
                *age += 1;
                *age
            }
            lowest => {
                *lowest = Some((loss, 0));
                0
            }
        };
        (self.batch, self.loss_sum, self.gradient_norm) = (0, 0.0, 0.0);
        (self.epoch, self.phase_epoch) = (self.epoch + 1, self.phase_epoch + 1);
        let exhausted = phase.patience.is_some_and(|patience| without_improvement >= patience);
        if self.phase_epoch == phase.epochs || exhausted {
            (self.phase, self.phase_epoch, self.lowest) = (self.phase + 1, 0, None);
        }
        is_best
    }

    /// Writes the state and the moments of the optimizer to a checkpoint.
    pub(super) fn write(&self, optimizer: &AdamW, inside: &Path) -> Result<()> {
        let moments = inside.join(OPTIMIZER);
        optimizer.moments.save_into(&mut store(&moments)).map_err(|error| cannot_write(&moments, &error))?;
        let optimizer_sha256 = digest_of_file(&moments)?;
        write_json(&inside.join(TRAINING), &TrainingFile { state: self.clone(), optimizer_sha256 })
    }

    /// Reads the state from a checkpoint. Restores the optimizer.
    pub(crate) fn read(directory: &Path, optimizer: &mut AdamW) -> Result<Self> {
        let TrainingFile { state, optimizer_sha256 } = read_json(&directory.join(TRAINING))?;
        let path = directory.join(OPTIMIZER);
        verify(&path, &optimizer_sha256)?;
        optimizer.moments.load_from(&mut store(&path)).map_err(|error| invalid(&path, &error))?;
        optimizer.steps = state.steps;
        Ok(state)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::PhaseConfig;
    use crate::config::tests::phase;
    use crate::data::split::Split;
    use crate::metrics::validation::{AvoidanceMetrics, Metrics};

    fn record(loss: f64) -> EpochRecord {
        let validation = AvoidanceMetrics { loss, rms_error: 0.0, skill: 0.0, right_side: 0.0 };
        EpochRecord {
            epoch: 0,
            phase: 0,
            steps: 0,
            learning_rate: 0.0,
            training_loss: 0.0,
            gradient_norm: 0.0,
            validation: Metrics::Avoidance(validation),
        }
    }

    #[test]
    fn a_phase_ends_when_epochs_or_patience_are_exhausted() {
        let split = Split::new(1, 0.1, &[0..10, 10..20]);
        let patient = PhaseConfig { patience: Some(2), ..phase(10) };
        let phases = [patient, phase(3)].map(|config| Phase::new(&config, 6, &split).unwrap());
        let mut state = TrainingState::default();
        assert_eq!(state.planned(&phases), [13 * 3, 13]);
        let mut complete = |loss: f64| {
            let phase = &phases[state.phase];
            (0..phase.batches).for_each(|_| state.step(1.0, 1.0));
            let is_best = state.complete_epoch(record(loss), phase);
            ((state.phase, state.phase_epoch, is_best), state.planned(&phases))
        };
        assert_eq!(complete(0.5), ((0, 1, true), [39, 13]));
        assert_eq!(complete(0.6), ((0, 2, false), [39, 13]));
        assert_eq!(complete(0.4), ((0, 3, true), [39, 13]));
        assert_eq!(complete(0.4), ((0, 4, false), [39, 13]));
        // An equal loss is no improvement, so this is the second epoch without one. Five of the ten epochs are skipped.
        assert_eq!(complete(0.45), ((1, 0, false), [24, 8]));
        // The best epoch belongs to the run, the lowest loss to the phase.
        assert_eq!(complete(0.9), ((1, 1, false), [24, 8]));
        assert_eq!(complete(0.8), ((1, 2, false), [24, 8]));
        assert_eq!(complete(0.3), ((2, 0, true), [24, 8]));
    }
}
