//! One linear constraint on the joint displacement: a row of `A` and `b` in the paper's Eq. (4).

use nalgebra::RowVector6;

/// `a q ≤ b`, or for a soft row `a q - s ≤ b` with its own slack `s ≥ 0`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Row {
    pub(super) a: RowVector6<f64>,
    pub(super) b: f64,
    pub(super) soft: bool,
}

impl Row {
    /// Returns a row that always holds.
    pub(crate) fn hard(a: RowVector6<f64>, b: f64) -> Self {
        Self { a, b, soft: false }
    }

    /// Returns a row that may be violated at a cost.
    pub(crate) fn soft(a: RowVector6<f64>, b: f64) -> Self {
        Self { a, b, soft: true }
    }

    /// Returns `a q - b`, which is positive where the row is violated.
    #[cfg(test)]
    pub(crate) fn excess(&self, q: &nalgebra::Vector6<f64>) -> f64 {
        (self.a * q)[0] - self.b
    }
}
