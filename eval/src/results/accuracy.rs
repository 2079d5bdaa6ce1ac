//! Final pose errors of sessions as statistics (paper, Table 1).
//!
//! All sessions count, including those that diverged. Errors are absolute values. The paper does not say whether it averages
//! signed or absolute errors; signed errors of opposite sign would cancel. The paper's norm of the mean errors is never above
//! the mean of the error norms (triangle inequality), and a few large errors hardly affect it. This module computes both.

use super::distribution::Distribution;
use crate::session::record::SessionRecord;
use datagen::statistics::percentile;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use world::PoseChange;

/// Final pose error of a session.
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

/// Accuracy of a system over its sessions, in meters and radians.
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
    /// Computes the statistics of the final errors of all sessions.
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

    /// Returns the paper's position norm: the norm of the three mean errors \[m\].
    pub fn position_norm(&self) -> f64 {
        norms(&self.axes.map(|axis| axis.mean))[0]
    }

    /// Returns the paper's orientation norm: the norm of the three mean errors \[rad\].
    pub fn orientation_norm(&self) -> f64 {
        norms(&self.axes.map(|axis| axis.mean))[1]
    }
}

/// Returns the norm of the three position errors and that of the three orientation errors.
pub(super) fn norms(axes: &[f64; 6]) -> [f64; 2] {
    let norm = |half: &[f64]| half.iter().map(|v| v * v).sum::<f64>().sqrt();
    [norm(&axes[..3]), norm(&axes[3..])]
}

/// Returns the 95 % bootstrap intervals of the two norms of means, from 2,000 resamples of the sessions with a fixed seed.
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
        // The standard error is about 0.3 mm, and the interval about four times as wide.
        assert!((0.6e-3..2.0e-3).contains(&(high - low)), "{low} to {high}");
    }

    #[test]
    fn one_diverged_session_stays_in_the_mean() {
        let mut errors = vec![error([1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]); 39];
        errors.push(error([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
        let accuracy = Accuracy::of(&errors);
        assert_relative_eq!(accuracy.position.mean, (39.0 * 1e-3 + 1.0) / 40.0, epsilon = 1e-12);
        assert_relative_eq!(accuracy.position.median, 1e-3);
    }
}
