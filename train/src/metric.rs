//! How good predictions are: millimetres and degrees for pose changes, skill for avoidance maps.

use serde::{Deserialize, Serialize};
use world::units::{to_deg, to_mm};

use crate::net::DIRECTIONS;
use crate::normalization::Standardization;

/// Which side of this an avoidance value lies on decides whether a direction counts as blocked.
const BLOCKED: f32 = datagen::statistics::BLOCKED as f32;

/// What is measured on the validation set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Metrics {
    /// Of `CNN_approach`.
    Approach(ApproachMetrics),
    /// Of `CNN_avoid`.
    Avoidance(AvoidanceMetrics),
}

impl Metrics {
    /// The loss, by which epochs are compared.
    pub fn loss(&self) -> f64 {
        match self {
            Self::Approach(metrics) => metrics.loss,
            Self::Avoidance(metrics) => metrics.loss,
        }
    }
}

/// Errors of pose changes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ApproachMetrics {
    /// Mean squared error of the standardized components.
    #[serde(rename = "validation_loss")]
    pub loss: f64,
    /// The paper's norm of means: of the mean absolute errors of x, y, z (as in Table 1).
    pub position_error_mm: f64,
    /// The paper's norm of means: of the mean absolute errors of phi, theta, psi.
    pub orientation_error_deg: f64,
    /// Mean absolute error of each component.
    #[serde(flatten)]
    pub axes: AxisErrors,
}

/// A mean absolute error for each component of a pose change, as the paper names them.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AxisErrors {
    /// Along x.
    #[serde(rename = "error_x_mm")]
    pub x_mm: f64,
    /// Along y.
    #[serde(rename = "error_y_mm")]
    pub y_mm: f64,
    /// Along z.
    #[serde(rename = "error_z_mm")]
    pub z_mm: f64,
    /// About x.
    #[serde(rename = "error_phi_deg")]
    pub phi_deg: f64,
    /// About y.
    #[serde(rename = "error_theta_deg")]
    pub theta_deg: f64,
    /// About z.
    #[serde(rename = "error_psi_deg")]
    pub psi_deg: f64,
}

impl ApproachMetrics {
    /// Compares what the network says, standardized, with the labels in metres and radians.
    ///
    /// # Panics
    /// If there are not as many of both.
    pub fn new(predicted: &[[f32; 6]], labels: &[[f64; 6]], standardization: &Standardization) -> Self {
        assert_eq!(predicted.len(), labels.len(), "one prediction a label");
        let (mut squares, mut errors) = (0.0, [0.0; 6]);
        for (predicted, label) in predicted.iter().zip(labels) {
            let predicted = predicted.map(f64::from);
            let target = standardization.standardize(*label);
            squares += predicted.iter().zip(&target).map(|(p, t)| (p - t).powi(2)).sum::<f64>();
            let predicted = standardization.restore(predicted);
            for axis in 0..6 {
                errors[axis] += (predicted[axis] - label[axis]).abs();
            }
        }
        let count = labels.len() as f64;
        let [x_mm, y_mm, z_mm] = [0, 1, 2].map(|axis| to_mm(errors[axis] / count));
        let [phi_deg, theta_deg, psi_deg] = [3, 4, 5].map(|axis| to_deg(errors[axis] / count));
        Self {
            loss: squares / (6.0 * count),
            position_error_mm: norm([x_mm, y_mm, z_mm]),
            orientation_error_deg: norm([phi_deg, theta_deg, psi_deg]),
            axes: AxisErrors { x_mm, y_mm, z_mm, phi_deg, theta_deg, psi_deg },
        }
    }
}

/// Errors of avoidance maps, limited to the range 0 to 1 as in use.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AvoidanceMetrics {
    /// Mean squared error.
    #[serde(rename = "validation_loss")]
    pub loss: f64,
    /// Its root.
    pub rms_error: f64,
    /// 1 - loss / (loss of the mean map of the training examples): 0 for knowing each direction's mean, 1 for perfect.
    pub skill: f64,
    /// Share of the directions that are on the right side of 0.5.
    pub right_side: f64,
}

impl AvoidanceMetrics {
    /// Compares predicted maps with the true ones; `mean_map` is that of the training examples.
    ///
    /// # Panics
    /// If there are not as many of both.
    pub fn new(predicted: &[[f32; DIRECTIONS]], maps: &[&[f32]], mean_map: &[f64]) -> Self {
        assert_eq!(predicted.len(), maps.len(), "one prediction a map");
        let (mut squares, mut squares_of_mean, mut right) = (0.0, 0.0, 0);
        for (predicted, map) in predicted.iter().zip(maps) {
            for ((predicted, value), mean) in predicted.iter().zip(*map).zip(mean_map) {
                let predicted = predicted.clamp(0.0, 1.0);
                squares += f64::from(predicted - value).powi(2);
                squares_of_mean += (mean - f64::from(*value)).powi(2);
                right += usize::from((predicted < BLOCKED) == (*value < BLOCKED));
            }
        }
        let count = (maps.len() * DIRECTIONS) as f64;
        let loss = squares / count;
        // Maps that are all the mean leave no error to explain.
        let skill = if squares_of_mean > 0.0 { 1.0 - squares / squares_of_mean } else { 0.0 };
        Self { loss, rms_error: loss.sqrt(), skill, right_side: right as f64 / count }
    }
}

fn norm([x, y, z]: [f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    #[test]
    fn pose_errors_by_hand() {
        let standardization =
            Standardization { mean: vec![0.0; 6], scale: vec![0.01, 0.01, 0.01, 0.1, 0.1, 0.1] };
        let labels = [[0.01, 0.0, 0.0, 0.1, 0.0, 0.0], [0.0; 6]];
        // Off by 1 and 5 mm in x, 4 and 4 mm in z (in opposite directions); by 0.02 rad once in psi.
        let predicted = [[1.1, 0.0, 0.4, 1.0, 0.0, 0.0], [-0.5, 0.0, -0.4, 0.0, 0.0, 0.2]];
        let metrics = ApproachMetrics::new(&predicted, &labels, &standardization);
        assert_relative_eq!(metrics.axes.x_mm, 3.0, epsilon = 1e-5);
        assert_relative_eq!(metrics.axes.y_mm, 0.0);
        assert_relative_eq!(metrics.axes.z_mm, 4.0, epsilon = 1e-5);
        assert_relative_eq!(metrics.axes.psi_deg, 0.01_f64.to_degrees(), epsilon = 1e-5);
        assert_relative_eq!(metrics.position_error_mm, 5.0, epsilon = 1e-5);
        assert_relative_eq!(metrics.orientation_error_deg, 0.01_f64.to_degrees(), epsilon = 1e-5);
        let squares = 0.1 * 0.1 + 0.4 * 0.4 + 0.5 * 0.5 + 0.4 * 0.4 + 0.2 * 0.2;
        assert_relative_eq!(metrics.loss, squares / 12.0, epsilon = 1e-6);
    }

    #[test]
    fn map_errors_by_hand() {
        let maps = [[0.0; DIRECTIONS], [1.0; DIRECTIONS]];
        let maps: Vec<&[f32]> = maps.iter().map(|map| &map[..]).collect();
        let mean = [0.5; DIRECTIONS];
        let half_right = AvoidanceMetrics::new(&[[0.25; DIRECTIONS], [0.25; DIRECTIONS]], &maps, &mean);
        assert_relative_eq!(half_right.loss, 0.3125);
        assert_relative_eq!(half_right.skill, 1.0 - 0.3125 / 0.25);
        assert_relative_eq!(half_right.right_side, 0.5);
        // What lies beyond the range is limited to it.
        let perfect = AvoidanceMetrics::new(&[[-0.5; DIRECTIONS], [1.5; DIRECTIONS]], &maps, &mean);
        assert_eq!((perfect.rms_error, perfect.skill, perfect.right_side), (0.0, 1.0, 1.0));
    }
}
