//! Where a run stands: what a checkpoint holds beside weights and moments, so that the run goes on as if it had never
//! stopped.

use serde::{Deserialize, Serialize};

use crate::curve::LossCurve;
use crate::history::EpochRecord;
use crate::phase::Phase;

/// Where a run stands.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Place {
    /// Complete phases.
    pub(crate) phase: usize,
    /// Complete epochs of the phase that is not complete.
    pub(crate) phase_epoch: usize,
    /// The lowest validation loss of that phase, and how many epochs ago it was.
    lowest: Option<(f64, usize)>,
    /// Complete epochs of the run.
    pub(crate) epoch: usize,
    /// Steps taken in the run.
    pub(crate) steps: usize,
    /// Steps taken in the epoch that is not complete.
    pub(crate) batch: usize,
    /// Sum of their losses.
    pub(crate) loss_sum: f64,
    /// Greatest norm of their gradients.
    pub(crate) gradient_norm: f64,
    /// The training loss so far.
    pub(crate) losses: LossCurve,
    /// The last complete epoch.
    pub(crate) last: Option<EpochRecord>,
    /// The complete epoch with the lowest validation loss, of the whole run.
    pub(crate) best: Option<EpochRecord>,
}

impl Place {
    /// Steps of its phase before this place.
    pub(crate) fn phase_steps(&self, phase: &Phase) -> usize {
        self.phase_epoch * phase.batches + self.batch
    }

    /// Steps and epochs of the whole run, if no further phase ends early.
    pub(crate) fn planned(&self, phases: &[Phase]) -> [usize; 2] {
        let mut planned = [self.steps, self.epoch];
        for (index, phase) in phases.iter().enumerate().skip(self.phase) {
            let done = if index == self.phase { [self.phase_steps(phase), self.phase_epoch] } else { [0; 2] };
            planned[0] += phase.epochs * phase.batches - done[0];
            planned[1] += phase.epochs - done[1];
        }
        planned
    }

    /// A step was taken.
    pub(crate) fn step(&mut self, loss: f64, gradient_norm: f64) {
        self.steps += 1;
        self.batch += 1;
        self.loss_sum += loss;
        self.gradient_norm = self.gradient_norm.max(gradient_norm);
    }

    /// An epoch is complete, and with it perhaps its phase. Is it the best so far?
    pub(crate) fn complete(&mut self, record: EpochRecord, phase: &Phase) -> bool {
        let loss = record.validation.loss();
        let is_best = self.best.as_ref().is_none_or(|best| loss < best.validation.loss());
        if is_best {
            self.best = Some(record.clone());
        }
        self.last = Some(record);
        self.lowest = match self.lowest {
            Some((lowest, age)) if loss >= lowest => Some((lowest, age + 1)),
            _ => Some((loss, 0)),
        };
        (self.batch, self.loss_sum, self.gradient_norm) = (0, 0.0, 0.0);
        (self.epoch, self.phase_epoch) = (self.epoch + 1, self.phase_epoch + 1);
        let in_vain = self.lowest.map_or(0, |(_, age)| age);
        if self.phase_epoch == phase.epochs || phase.patience.is_some_and(|patience| in_vain >= patience) {
            (self.phase, self.phase_epoch, self.lowest) = (self.phase + 1, 0, None);
        }
        is_best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::PhaseConfig;
    use crate::config::tests::phase;
    use crate::metric::{AvoidanceMetrics, Metrics};
    use crate::split::Split;

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
    fn a_phase_ends_when_its_epochs_or_its_patience_do() {
        let split = Split::new(1, 0.1, &[0..10, 10..20]);
        let patient = PhaseConfig { patience: Some(2), ..phase(10) };
        let phases = [patient, phase(3)].map(|config| Phase::new(&config, 6, &split).unwrap());
        let mut place = Place::default();
        assert_eq!(place.planned(&phases), [13 * 3, 13]);
        let mut complete = |loss: f64| {
            let phase = &phases[place.phase];
            (0..phase.batches).for_each(|_| place.step(1.0, 1.0));
            let is_best = place.complete(record(loss), phase);
            ((place.phase, place.phase_epoch, is_best), place.planned(&phases))
        };
        assert_eq!(complete(0.5), ((0, 1, true), [39, 13]));
        assert_eq!(complete(0.6), ((0, 2, false), [39, 13]));
        assert_eq!(complete(0.4), ((0, 3, true), [39, 13]));
        assert_eq!(complete(0.4), ((0, 4, false), [39, 13]));
        // Equal is no improvement: the second epoch in vain. Five epochs of the next ten are not taken.
        assert_eq!(complete(0.45), ((1, 0, false), [24, 8]));
        // The best is that of the run, the lowest that of the phase.
        assert_eq!(complete(0.9), ((1, 1, false), [24, 8]));
        assert_eq!(complete(0.8), ((1, 2, false), [24, 8]));
        assert_eq!(complete(0.3), ((2, 0, true), [24, 8]));
    }
}
