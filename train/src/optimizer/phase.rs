//! The plan of a phase: examples and steps per epoch, and the learning rate of each step.

use super::one_cycle::OneCycle;
use crate::config::PhaseConfig;
use crate::data::split::Split;
use crate::error::{Error, Result};

/// A phase of a run, planned for its datasets.
#[derive(Debug)]
pub(crate) struct Phase {
    /// Maximum number of epochs.
    pub(crate) epochs: usize,
    /// Epochs without improvement after which the phase stops.
    pub(crate) patience: Option<usize>,
    /// Examples per epoch of each dataset.
    pub(crate) counts: Vec<usize>,
    /// Steps per epoch. An incomplete last batch is dropped unless it is the only one. Other epochs order the examples
    /// differently.
    pub(crate) batches: usize,
    schedule: OneCycle,
}

impl Phase {
    /// Plans a phase with `batch` examples per step.
    pub(crate) fn new(config: &PhaseConfig, batch: usize, split: &Split) -> Result<Self> {
        let available: Vec<usize> = split.training.iter().map(Vec::len).collect();
        let counts = match &config.ratio {
            Some(ratio) => in_ratio(ratio, &available),
            None => available,
        };
        let examples: usize = counts.iter().sum();
        if examples == 0 {
            let found = split.validation.len() + split.all_training().len();
            return Err(Error::TooFewExamples { found, needed: 1 + split.training.len() });
        }
        let batches = (examples / batch).max(1);
        let schedule = OneCycle::new(config, config.epochs * batches);
        Ok(Self { epochs: config.epochs, patience: config.patience, counts, batches, schedule })
    }

    /// Returns the learning rate of a step, numbered from 0 within the phase.
    pub(crate) fn learning_rate(&self, step: usize) -> f64 {
        self.schedule.rate(step)
    }
}

/// Returns `floor(r_i min_j(len_j / r_j))` for each dataset i, with j over `r_j > 0`: every example of the dataset that is
/// scarcest relative to the ratio, and a proportional number of the others.
fn in_ratio(ratio: &[u32], available: &[usize]) -> Vec<usize> {
    let ratio: Vec<usize> = ratio.iter().map(|&part| part as usize).collect();
    let count = |own: &usize| {
        let wanted = ratio.iter().zip(available).filter(|&(&part, _)| part > 0);
        wanted.map(|(part, len)| own * len / part).min().unwrap_or(0)
    };
    ratio.iter().map(count).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::tests::phase;

    #[test]
    fn the_scarcest_dataset_decides() {
        assert_eq!(in_ratio(&[20, 20, 12], &[19_000, 19_000, 11_400]), [19_000, 19_000, 11_400]);
        assert_eq!(in_ratio(&[20, 20, 12], &[19_000, 500, 11_400]), [500, 500, 300]);
        assert_eq!(in_ratio(&[1, 0, 2], &[100, 0, 33]), [16, 0, 33]);
        assert_eq!(in_ratio(&[3, 7], &[10, 10]), [4, 10]);
    }

    #[test]
    fn an_epoch_takes_its_ratio_in_whole_batches() {
        let split = Split::new(1, 0.1, &[0..100, 100..140]);
        let laid_out = |ratio: Option<Vec<u32>>| {
            let phase = Phase::new(&PhaseConfig { ratio, ..phase(3) }, 16, &split).unwrap();
            (phase.counts, phase.batches)
        };
        assert_eq!(laid_out(None), (vec![90, 36], 7));
        assert_eq!(laid_out(Some(vec![1, 1])), (vec![36, 36], 4));
        assert_eq!(laid_out(Some(vec![0, 1])), (vec![0, 36], 2));
        // A dataset whose only example is held out has no training examples.
        let empty = Split::new(1, 0.1, &[0..100, 100..101]);
        let error = Phase::new(&PhaseConfig { ratio: Some(vec![1, 1]), ..phase(3) }, 16, &empty).unwrap_err();
        assert!(matches!(error, Error::TooFewExamples { found: 101, .. }), "{error}");
    }
}
