//! The training loss over a run, coarse enough to be plotted and stored in every checkpoint.

use serde::{Deserialize, Serialize};

/// Approximate number of points per run.
const POINTS: usize = 100;

/// Losses averaged over groups of batches.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct LossCurve {
    /// End of each group, in epochs since the start of the run, and its mean loss.
    pub(crate) points: Vec<[f64; 2]>,
    sum: f64,
    batches: usize,
}

impl LossCurve {
    /// Adds a batch, after which `epochs` epochs are complete. The run has `planned` batches.
    pub(crate) fn add(&mut self, loss: f64, epochs: f64, planned: usize) {
        self.sum += loss;
        self.batches += 1;
        if self.batches >= planned.div_ceil(POINTS) {
            self.points.push([epochs, self.sum / self.batches as f64]);
            (self.sum, self.batches) = (0.0, 0);
        }
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    #[test]
    fn groups_are_averaged_where_they_end() {
        let mut curve = LossCurve::default();
        for i in 1..=250 {
            curve.add(f64::from(i), f64::from(i) / 125.0, 250);
        }
        assert_eq!(curve.points.len(), 83);
        assert_relative_eq!(curve.points[0][..], [0.024, 2.0]);
        assert_relative_eq!(curve.points[82][..], [1.992, 248.0]);
    }
}
