//! Summary statistics of a sequence of numbers, in one pass.

use serde::{Deserialize, Serialize};

/// Minimum, mean, standard deviation and maximum of a population.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SummaryStats {
    /// Minimum.
    pub min: f64,
    /// Mean.
    pub mean: f64,
    /// Population standard deviation: the divisor is the count.
    pub std: f64,
    /// Maximum.
    pub max: f64,
}

/// Accumulator of [`SummaryStats`].
///
/// Welford, "Note on a method for calculating corrected sums of squares and products", Technometrics 4 (1962). Merging follows
/// Chan, Golub and `LeVeque`, "Algorithms for computing the sample variance", The American Statistician 37 (1983).
#[derive(Debug, Clone, Copy)]
pub(super) struct RunningStats {
    count: u64,
    mean: f64,
    /// Sum of squared deviations from the mean.
    squares: f64,
    min: f64,
    max: f64,
}

impl RunningStats {
    /// The empty accumulator.
    pub(super) const EMPTY: Self =
        Self { count: 0, mean: 0.0, squares: 0.0, min: f64::INFINITY, max: f64::NEG_INFINITY };

    /// Adds a number.
    pub(super) fn add(&mut self, value: f64) {
        self.count += 1;
        let from_mean = value - self.mean;
        self.mean += from_mean / self.count as f64;
        self.squares += from_mean * (value - self.mean);
        (self.min, self.max) = (self.min.min(value), self.max.max(value));
    }

    /// Adds the numbers of another accumulator.
    pub(super) fn merge(&mut self, other: &Self) {
        if other.count == 0 {
            return;
        }
        let (ours, theirs) = (self.count as f64, other.count as f64);
        let apart = other.mean - self.mean;
        self.count += other.count;
        self.mean += apart * (theirs / (ours + theirs));
        self.squares += other.squares + apart * apart * (ours * theirs / (ours + theirs));
        (self.min, self.max) = (self.min.min(other.min), self.max.max(other.max));
    }

    /// Returns the statistics of the numbers so far; NaN and infinities if there are none.
    pub(super) fn summary(&self) -> SummaryStats {
        let std = (self.squares / self.count as f64).sqrt();
        SummaryStats { min: self.min, mean: self.mean, std, max: self.max }
    }
}

/// Returns a percentile of numbers in ascending order, or NaN if there are none.
///
/// Interpolates linearly at rank `(n - 1) percent / 100`, like R's type 7 and numpy's default.
pub fn percentile(ascending: &[f64], percent: f64) -> f64 {
    let Some(last) = ascending.len().checked_sub(1) else { return f64::NAN };
    let rank = last as f64 * percent / 100.0;
    let below = rank.floor() as usize;
    let above = (below + 1).min(last);
    ascending[below] + (ascending[above] - ascending[below]) * (rank - rank.floor())
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn stats(values: &[f64]) -> RunningStats {
        let mut stats = RunningStats::EMPTY;
        for &value in values {
            stats.add(value);
        }
        stats
    }

    #[test]
    fn eight_numbers_have_the_expected_statistics() {
        let summary = stats(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]).summary();
        assert_eq!((summary.min, summary.max), (2.0, 9.0));
        assert_relative_eq!(summary.mean, 5.0, epsilon = 1e-15);
        assert_relative_eq!(summary.std, 2.0, epsilon = 1e-15);
        assert_eq!(stats(&[0.3]).summary(), SummaryStats { min: 0.3, mean: 0.3, std: 0.0, max: 0.3 });
    }

    #[test]
    fn a_large_offset_does_not_cancel_the_variance() {
        let summary = stats(&[1e9 + 4.0, 1e9 + 7.0, 1e9 + 13.0, 1e9 + 16.0]).summary();
        assert_relative_eq!(summary.std, 22.5f64.sqrt(), epsilon = 1e-12);
    }

    proptest! {
        #[test]
        fn merged_parts_equal_the_whole(
            values in prop::collection::vec(-10.0..10.0f64, 1..60), cut in 0.0..1.0f64
        ) {
            let (left, right) = values.split_at((cut * values.len() as f64) as usize);
            let mut merged = stats(left);
            merged.merge(&stats(right));
            let (merged, whole) = (merged.summary(), stats(&values).summary());
            prop_assert_eq!((merged.min, merged.max), (whole.min, whole.max));
            assert_relative_eq!(merged.mean, whole.mean, epsilon = 1e-13);
            assert_relative_eq!(merged.std, whole.std, epsilon = 1e-12);
        }
    }

    #[test]
    fn percentiles_interpolate_between_neighbors() {
        let values: Vec<f64> = (0..=100).map(f64::from).collect();
        for percent in [0.0, 2.5, 50.0, 97.5, 100.0] {
            assert_relative_eq!(percentile(&values, percent), percent, epsilon = 1e-12);
        }
        assert_relative_eq!(percentile(&[1.0, 2.0, 3.0, 4.0], 50.0), 2.5);
        assert_relative_eq!(percentile(&[0.0, 10.0], 95.0), 9.5);
        assert_relative_eq!(percentile(&[7.0], 95.0), 7.0);
        assert!(percentile(&[], 50.0).is_nan());
    }
}
