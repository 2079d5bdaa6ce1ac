//! Final pose errors of servo sessions as statistics (paper, Table 1).
//!
//! Every session counts, also one that ran away. Errors are absolute values: the paper does not say whether its averages are
//! of signed or of absolute errors, and signed ones would let two misses cancel. Beside the paper's figures stands what its
//! norm of means hides: by the triangle inequality it is never above the mean of the norms, and a few bad sessions hardly
//! show in it.

use crate::trace::SessionRecord;
use datagen::statistics::percentile;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use world::PoseChange;

/// How far a session ended from its goal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FinalError {
    /// Final minus goal pose, `(x y z φ θ ψ)` in the robot frame \[m\], \[rad\].
    pub difference: PoseChange,
    /// Angle of the rotation from the goal to the final orientation \[rad\].
    pub angle: f64,
}

impl From<&SessionRecord> for FinalError {
    fn from(record: &SessionRecord) -> Self {
        Self { difference: PoseChange::from_array(record.final_error), angle: record.orientation_error }
    }
}

/// What is told about a set of numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distribution {
    /// Mean.
    pub mean: f64,
    /// Standard deviation of the population that the numbers are a sample of (divisor n - 1).
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
    /// Of numbers in any order. Without numbers every statistic is NaN, and so is the standard deviation of a single one.
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

/// Accuracy of a system over its sessions; metres and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Accuracy {
    /// Absolute error of each pose variable, `x y z φ θ ψ`.
    pub axes: [Distribution; 6],
    /// Distance between final and goal position.
    pub position: Distribution,
    /// Angle between final and goal orientation.
    pub orientation: Distribution,
    /// 95 % confidence interval of [`Accuracy::position_norm`], by bootstrap over the sessions.
    pub position_norm_interval: [f64; 2],
    /// 95 % confidence interval of [`Accuracy::orientation_norm`], by bootstrap over the sessions.
    pub orientation_norm_interval: [f64; 2],
}

impl Accuracy {
    /// Over the final errors of all sessions.
    pub fn of(errors: &[FinalError]) -> Self {
        let absolute: Vec<[f64; 6]> = errors.iter().map(|e| e.difference.to_array().map(f64::abs)).collect();
        let axis = |i: usize| Distribution::of(&absolute.iter().map(|e| e[i]).collect::<Vec<_>>());
        let distances: Vec<f64> = errors.iter().map(|e| e.difference.translation.norm()).collect();
        let angles: Vec<f64> = errors.iter().map(|e| e.angle).collect();
        let [position_norm_interval, orientation_norm_interval] = norm_intervals(&absolute);
        Self {
            axes: std::array::from_fn(axis),
            position: Distribution::of(&distances),
            orientation: Distribution::of(&angles),
            position_norm_interval,
            orientation_norm_interval,
        }
    }

    /// The paper's position norm: the norm of the three mean errors \[m\].
    pub fn position_norm(&self) -> f64 {
        norms(&self.axes.map(|axis| axis.mean))[0]
    }

    /// The paper's orientation norm: the norm of the three mean errors \[rad\].
    pub fn orientation_norm(&self) -> f64 {
        norms(&self.axes.map(|axis| axis.mean))[1]
    }
}

/// Norms of the position half and of the orientation half of six numbers.
pub(crate) fn norms(axes: &[f64; 6]) -> [f64; 2] {
    let norm = |half: &[f64]| half.iter().map(|v| v * v).sum::<f64>().sqrt();
    [norm(&axes[..3]), norm(&axes[3..])]
}

/// 95 % bootstrap intervals of the two norms of means: 2,000 resamples of the sessions with a fixed seed.
fn norm_intervals(absolute: &[[f64; 6]]) -> [[f64; 2]; 2] {
    const RESAMPLES: usize = 2000;
    if absolute.is_empty() {
        return [[f64::NAN; 2]; 2];
    }
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut resampled = [Vec::with_capacity(RESAMPLES), Vec::with_capacity(RESAMPLES)];
    for _ in 0..RESAMPLES {
        let mut mean = [0.0; 6];
        for _ in absolute {
            let drawn = &absolute[rng.random_range(0..absolute.len())];
            for (sum, value) in mean.iter_mut().zip(drawn) {
                *sum += value / absolute.len() as f64;
            }
        }
        let [position, orientation] = norms(&mean);
        resampled[0].push(position);
        resampled[1].push(orientation);
    }
    resampled.map(|mut values| {
        values.sort_by(f64::total_cmp);
        [percentile(&values, 2.5), percentile(&values, 97.5)]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn error(axes: [f64; 6]) -> FinalError {
        let difference = PoseChange::from_array(axes);
        FinalError { difference, angle: difference.rotation.norm() }
    }

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

    #[test]
    fn opposite_misses_do_not_cancel() {
        let misses = [error([3e-3, 0.0, 0.0, 0.0, 0.0, 0.1]), error([-3e-3, 0.0, 4e-3, 0.0, 0.0, -0.1])];
        let accuracy = Accuracy::of(&misses);
        assert_relative_eq!(accuracy.axes[0].mean, 3e-3);
        assert_relative_eq!(accuracy.axes[5].mean, 0.1);
        assert_relative_eq!(accuracy.position_norm(), 13f64.sqrt() * 1e-3, epsilon = 1e-15);
        assert_relative_eq!(accuracy.orientation_norm(), 0.1, epsilon = 1e-15);
        assert_relative_eq!(accuracy.position.mean, 4e-3, epsilon = 1e-15);
    }

    #[test]
    fn the_norm_of_means_lies_in_its_interval_and_below_the_mean_of_norms() {
        let errors: Vec<FinalError> = (0..40)
            .map(|i| error([f64::from(i % 7) * 1e-3, f64::from(i % 5) * -1e-3, 0.0, 0.0, 0.0, 0.0]))
            .collect();
        let accuracy = Accuracy::of(&errors);
        let [low, high] = accuracy.position_norm_interval;
        assert!(low < accuracy.position_norm() && accuracy.position_norm() < high);
        assert!(accuracy.position_norm() < accuracy.position.mean);
        // The standard error of about 0.3 mm makes an interval of about four times that.
        assert!((0.6e-3..2.0e-3).contains(&(high - low)), "{low} to {high}");
    }

    #[test]
    fn one_runaway_session_stays_in_the_mean() {
        let mut errors = vec![error([1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]); 39];
        errors.push(error([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
        let accuracy = Accuracy::of(&errors);
        assert_relative_eq!(accuracy.position.mean, (39.0 * 1e-3 + 1.0) / 40.0, epsilon = 1e-12);
        assert_relative_eq!(accuracy.position.median, 1e-3);
    }
}
