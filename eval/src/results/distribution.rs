//! Statistics of a set of numbers.

use datagen::statistics::percentile;

/// Statistics of a set of numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distribution {
    /// Mean.
    pub mean: f64,
    /// Sample standard deviation (divisor n - 1).
    pub standard_deviation: f64,
    /// Root of the mean square.
    pub root_mean_square: f64,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub percentile_95: f64,
    /// Maximum.
    pub maximum: f64,
}

impl Distribution {
    /// Computes the statistics of numbers in any order. They are NaN for an empty set, as is the standard deviation of a single
    /// number.
    pub fn of(values: &[f64]) -> Self {
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let spread: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
        let squares: f64 = values.iter().map(|v| v * v).sum();
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        Self {
            mean,
            standard_deviation: (spread / (count - 1.0)).sqrt(),
            root_mean_square: (squares / count).sqrt(),
            median: percentile(&sorted, 50.0),
            percentile_95: percentile(&sorted, 95.0),
            maximum: sorted.last().copied().unwrap_or(f64::NAN),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn statistics_of_a_sample_done_by_hand() {
        let d = Distribution::of(&[7.0, 1.0, 2.0, 2.0]);
        assert_relative_eq!(d.mean, 3.0);
        // Squared deviations 16 + 4 + 1 + 1 = 22 over 3; squares 49 + 1 + 4 + 4 = 58 over 4.
        assert_relative_eq!(d.standard_deviation, (22.0f64 / 3.0).sqrt());
        assert_relative_eq!(d.root_mean_square, 14.5f64.sqrt());
        assert_relative_eq!(d.median, 2.0);
        // Rank 3 * 0.95 = 2.85 lies between 2 and 7.
        assert_relative_eq!(d.percentile_95, 2.0 + 0.85 * 5.0, epsilon = 1e-12);
        assert_relative_eq!(d.maximum, 7.0);
    }
}
