//! How numbers spread: summed up in one pass, in parts that are joined in order.

use serde::{Deserialize, Serialize};

/// Extremes, mean and standard deviation of some numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// The smallest.
    pub min: f64,
    /// Their mean.
    pub mean: f64,
    /// Their standard deviation; the numbers are all there are, so the divisor is their count.
    pub std: f64,
    /// The largest.
    pub max: f64,
}

/// A running [`Spread`].
///
/// Welford, "Note on a method for calculating corrected sums of squares and products", Technometrics 4 (1962); joined as by
/// Chan, Golub and `LeVeque`, "Algorithms for computing the sample variance", The American Statistician 37 (1983).
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tally {
    count: u64,
    mean: f64,
    /// Sum of the squared distances from the mean.
    squares: f64,
    min: f64,
    max: f64,
}

impl Tally {
    /// Of no number.
    pub(crate) const EMPTY: Self =
        Self { count: 0, mean: 0.0, squares: 0.0, min: f64::INFINITY, max: f64::NEG_INFINITY };

    /// One more number.
    pub(crate) fn add(&mut self, value: f64) {
        self.count += 1;
        let from_mean = value - self.mean;
        self.mean += from_mean / self.count as f64;
        self.squares += from_mean * (value - self.mean);
        (self.min, self.max) = (self.min.min(value), self.max.max(value));
    }

    /// The numbers of another tally, too.
    pub(crate) fn join(&mut self, other: &Self) {
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

    /// Where there was any number.
    pub(crate) fn spread(&self) -> Spread {
        let std = (self.squares / self.count as f64).sqrt();
        Spread { min: self.min, mean: self.mean, std, max: self.max }
    }
}

/// Percentile of ascending numbers, linear between neighbors at rank `(n - 1) percent / 100` (R's type 7, numpy's default);
/// NaN without numbers.
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

    fn tally(values: &[f64]) -> Tally {
        let mut tally = Tally::EMPTY;
        for &value in values {
            tally.add(value);
        }
        tally
    }

    #[test]
    fn eight_numbers_with_round_statistics() {
        let spread = tally(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]).spread();
        assert_eq!((spread.min, spread.max), (2.0, 9.0));
        assert_relative_eq!(spread.mean, 5.0, epsilon = 1e-15);
        assert_relative_eq!(spread.std, 2.0, epsilon = 1e-15);
        assert_eq!(tally(&[0.3]).spread(), Spread { min: 0.3, mean: 0.3, std: 0.0, max: 0.3 });
    }

    #[test]
    fn a_large_offset_does_not_drown_the_spread() {
        let spread = tally(&[1e9 + 4.0, 1e9 + 7.0, 1e9 + 13.0, 1e9 + 16.0]).spread();
        assert_relative_eq!(spread.std, 22.5f64.sqrt(), epsilon = 1e-12);
    }

    proptest! {
        #[test]
        fn parts_join_to_the_whole(
            values in prop::collection::vec(-10.0..10.0f64, 1..60), cut in 0.0..1.0f64
        ) {
            let (left, right) = values.split_at((cut * values.len() as f64) as usize);
            let mut joined = tally(left);
            joined.join(&tally(right));
            let (joined, whole) = (joined.spread(), tally(&values).spread());
            prop_assert_eq!((joined.min, joined.max), (whole.min, whole.max));
            assert_relative_eq!(joined.mean, whole.mean, epsilon = 1e-13);
            assert_relative_eq!(joined.std, whole.std, epsilon = 1e-12);
        }
    }

    #[test]
    fn percentiles_lie_between_neighbors() {
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
