//! The one-cycle learning rate (Smith and Topin 2019): a rise to the peak and a fall to almost zero, both along a cosine.

use crate::config::PhaseConfig;

/// Ratio of the peak to the first rate.
const RISE: f64 = 25.0;
/// Ratio of the first rate to the last one.
const FALL: f64 = 1e4;

/// Learning rate as a function of the step.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct OneCycle {
    peak: f64,
    peak_at: f64,
    last: f64,
}

impl OneCycle {
    /// Returns the cycle of a phase with `steps` steps.
    pub(crate) fn new(config: &PhaseConfig, steps: usize) -> Self {
        let last = steps.saturating_sub(1) as f64;
        Self { peak: config.learning_rate, peak_at: config.warmup * last, last }
    }

    /// Returns the learning rate of a step, numbered from 0.
    pub(crate) fn rate(&self, step: usize) -> f64 {
        let first = self.peak / RISE;
        let step = step as f64;
        if step < self.peak_at {
            along_cosine(first, self.peak, step / self.peak_at)
        } else {
            let rest = (self.last - self.peak_at).max(1.0);
            along_cosine(self.peak, first / FALL, ((step - self.peak_at) / rest).min(1.0))
        }
    }
}

/// Interpolates between `from` at 0 and `to` at 1 with zero slope at both ends.
fn along_cosine(from: f64, to: f64, share: f64) -> f64 {
    to + (from - to) * 0.5 * (1.0 + (std::f64::consts::PI * share).cos())
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;
    use crate::config::tests::phase;

    fn cycle(steps: usize) -> OneCycle {
        OneCycle::new(&PhaseConfig { learning_rate: 1e-3, warmup: 0.1, ..phase(1) }, steps)
    }

    #[test]
    fn known_points() {
        // A quarter of the way down, (1 + cos 45 degrees) / 2 of the height remains.
        assert_relative_eq!(cycle(81).rate(8 + 18), 1e-3 * 0.853_553_39, max_relative = 1e-5);
        let cycle = cycle(101);
        assert_relative_eq!(cycle.rate(0), 4e-5, max_relative = 1e-12);
        assert_relative_eq!(cycle.rate(5), 0.5 * (4e-5 + 1e-3), max_relative = 1e-12);
        assert_relative_eq!(cycle.rate(10), 1e-3, max_relative = 1e-12);
        assert_relative_eq!(cycle.rate(55), 0.5 * (1e-3 + 4e-9), max_relative = 1e-12);
        assert_relative_eq!(cycle.rate(100), 4e-9, max_relative = 1e-9);
    }

    #[test]
    fn rises_once_and_falls_once() {
        let cycle = cycle(1000);
        let rates: Vec<f64> = (0..1000).map(|step| cycle.rate(step)).collect();
        let turns = rates.windows(3).filter(|r| (r[1] > r[0]) != (r[2] > r[1])).count();
        assert_eq!(turns, 1);
    }

    #[test]
    fn one_step_is_a_cycle() {
        assert_relative_eq!(cycle(1).rate(0), 1e-3);
    }
}
