//! Per-axis standardization of the regression target, so that networks learn values of order one in any unit.

use serde::{Deserialize, Serialize};

/// A standard deviation below this (a nanometer, a nanoradian) is rounding. Such an axis is constant and not scaled.
const CONSTANT: f64 = 1e-9;

/// `standardized = (label - mean) / scale`. Computed on the training set and stored with the weights.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Standardization {
    /// Mean of each axis in the units of the label.
    pub mean: Vec<f64>,
    /// Scale of each axis in the units of the label.
    pub scale: Vec<f64>,
}

impl Standardization {
    /// Standardizes by mean and standard deviation. Returns `None` if there are no labels or one is not finite.
    pub fn centered<const N: usize>(labels: &[[f64; N]]) -> Option<Self> {
        Self::around(mean(labels, |_, value| value), labels)
    }

    /// Standardizes by the root mean square with mean zero, for antisymmetric networks: any other mean would break the
    /// symmetry. Returns `None` if there are no labels or one is not finite.
    pub fn antisymmetric<const N: usize>(labels: &[[f64; N]]) -> Option<Self> {
        Self::around([0.0; N], labels)
    }

    fn around<const N: usize>(center: [f64; N], labels: &[[f64; N]]) -> Option<Self> {
        let variance = mean(labels, |axis, value| (value - center[axis]).powi(2));
        let scale = variance.map(|v| if v.sqrt() < CONSTANT { 1.0 } else { v.sqrt() });
        // The mean of no labels is NaN, and a label that is not finite makes its scale not finite.
        scale.iter().all(|s| s.is_finite()).then(|| Self { mean: center.to_vec(), scale: scale.to_vec() })
    }

    /// Returns whether this is a valid standardization of labels with `N` axes.
    pub(crate) fn fits<const N: usize>(&self) -> bool {
        let positive = |scale: &f64| scale.is_finite() && *scale > 0.0;
        self.mean.len() == N && self.scale.len() == N && self.scale.iter().all(positive)
    }

    /// Converts a label to the target of the network.
    ///
    /// # Panics
    /// If the label has another number of axes.
    pub fn standardize<const N: usize>(&self, label: [f64; N]) -> [f64; N] {
        assert_eq!(N, self.mean.len(), "a label of {N} axes");
        std::array::from_fn(|i| (label[i] - self.mean[i]) / self.scale[i])
    }

    /// Converts an output of the network to a label.
    ///
    /// # Panics
    /// If the output has another number of axes.
    pub fn restore<const N: usize>(&self, standardized: [f64; N]) -> [f64; N] {
        assert_eq!(N, self.mean.len(), "an output of {N} axes");
        std::array::from_fn(|i| standardized[i] * self.scale[i] + self.mean[i])
    }
}

/// Returns the mean over the labels of a function of axis and value.
fn mean<const N: usize>(labels: &[[f64; N]], of: impl Fn(usize, f64) -> f64) -> [f64; N] {
    std::array::from_fn(|axis| {
        labels.iter().map(|label| of(axis, label[axis])).sum::<f64>() / labels.len() as f64
    })
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    const LABELS: [[f64; 3]; 4] = [[1.0, -2.0, 7.0], [3.0, 2.0, 7.0], [1.0, -2.0, 7.0], [3.0, 2.0, 7.0]];

    #[test]
    fn known_moments() {
        let s = Standardization::centered(&LABELS).unwrap();
        assert_eq!((s.mean.as_slice(), s.scale.as_slice()), (&[2.0, 0.0, 7.0][..], &[1.0, 2.0, 1.0][..]));
        assert_relative_eq!(s.standardize([3.0, 2.0, 7.0])[..], [1.0, 1.0, 0.0]);
        let s = Standardization::antisymmetric(&LABELS).unwrap();
        assert_eq!(s.mean, [0.0; 3]);
        assert_relative_eq!(s.scale[0], 5.0_f64.sqrt());
        assert_relative_eq!(s.scale[2], 7.0);
        assert_relative_eq!(s.standardize([0.0; 3])[..], [0.0; 3]);
    }

    #[test]
    fn restore_inverts_and_serde_keeps() {
        let s = Standardization::centered(&LABELS).unwrap();
        let label = [0.3, -0.1, 9.0];
        for (restored, value) in s.restore(s.standardize(label)).into_iter().zip(label) {
            assert_relative_eq!(restored, value, epsilon = 1e-15);
        }
        let text = serde_json::to_string(&s).unwrap();
        assert_eq!(serde_json::from_str::<Standardization>(&text).unwrap(), s);
        assert!(serde_json::from_str::<Standardization>(r#"{"mean": [], "scale": [], "std": []}"#).is_err());
    }

    #[test]
    fn labels_without_moments_are_refused() {
        assert_eq!(Standardization::centered::<3>(&[]), None);
        assert_eq!(Standardization::antisymmetric(&[[1.0, f64::NAN]]), None);
        assert_eq!(Standardization::centered(&[[1.0], [f64::INFINITY]]), None);
    }
}
