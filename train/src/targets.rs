//! What the outputs of a network are compared with: in training as tensors, in validation as numbers that mean
//! something.

use burn::tensor::{Device, Tensor, TensorData};

use crate::config::Task;
use crate::error::{Error, Result};
use crate::examples::{Examples, Labels};
use crate::metric::{ApproachMetrics, AvoidanceMetrics, Metrics};
use crate::net::{DIRECTIONS, Symmetry};
use crate::normalization::Standardization;

/// The labels of all examples, and what of them is known from the training examples.
pub(crate) enum Targets<'a> {
    PoseChanges { labels: &'a [[f64; 6]], standardization: Standardization },
    AvoidanceMaps { values: &'a [f32], mean: Vec<f64> },
}

impl<'a> Targets<'a> {
    /// With the standardization that is `decided` already, or else that of the training examples.
    pub(crate) fn new(
        task: &Task,
        examples: &'a Examples,
        training: &[usize],
        decided: Option<Standardization>,
    ) -> Result<Self> {
        match (task, examples.labels()) {
            (Task::Approach { network, .. }, Labels::PoseChanges(labels)) => {
                let learned: Vec<_> = training.iter().map(|&index| labels[index]).collect();
                let standardization = match network.symmetry {
                    Symmetry::Antisymmetric => Standardization::antisymmetric(&learned),
                    Symmetry::None => Standardization::centered(&learned),
                };
                let standardization = standardization.ok_or(Error::LabelsNotFinite)?;
                Ok(Self::PoseChanges { labels, standardization: decided.unwrap_or(standardization) })
            }
            (Task::Avoidance { .. }, Labels::AvoidanceMaps(values)) => {
                let mean = mean_map(training.iter().map(|&index| map(values, index)));
                // A sum is finite only if all it is made of is.
                let finite = mean.iter().all(|value| value.is_finite());
                if finite { Ok(Self::AvoidanceMaps { values, mean }) } else { Err(Error::LabelsNotFinite) }
            }
            _ => panic!("examples of the other task"),
        }
    }

    /// What brings the output into the label's units; avoidance maps need nothing.
    pub(crate) fn standardization(&self) -> Option<&Standardization> {
        match self {
            Self::PoseChanges { standardization, .. } => Some(standardization),
            Self::AvoidanceMaps { .. } => None,
        }
    }

    /// # Shapes
    /// - result: `[indices, outputs]`
    pub(crate) fn tensor(&self, indices: &[usize], device: &Device) -> Tensor<2> {
        let (values, outputs) = match self {
            Self::PoseChanges { labels, standardization } => {
                let standardized =
                    indices.iter().flat_map(|&index| standardization.standardize(labels[index]));
                (standardized.map(|value| value as f32).collect(), 6)
            }
            Self::AvoidanceMaps { values, .. } => {
                (indices.iter().flat_map(|&index| map(values, index)).copied().collect(), DIRECTIONS)
            }
        };
        Tensor::from_data(TensorData::new(values, [indices.len(), outputs]), device)
    }

    /// How good the outputs for some examples are, given one row after the other.
    pub(crate) fn metrics(&self, indices: &[usize], outputs: &[f32]) -> Metrics {
        match self {
            Self::PoseChanges { labels, standardization } => {
                let labels: Vec<_> = indices.iter().map(|&index| labels[index]).collect();
                let (predicted, _) = outputs.as_chunks();
                Metrics::Approach(ApproachMetrics::new(predicted, &labels, standardization))
            }
            Self::AvoidanceMaps { values, mean } => {
                let maps: Vec<_> = indices.iter().map(|&index| map(values, index)).collect();
                let (predicted, _) = outputs.as_chunks();
                Metrics::Avoidance(AvoidanceMetrics::new(predicted, &maps, mean))
            }
        }
    }
}

fn map(values: &[f32], index: usize) -> &[f32] {
    &values[index * DIRECTIONS..(index + 1) * DIRECTIONS]
}

/// The mean of each direction.
fn mean_map<'a>(maps: impl ExactSizeIterator<Item = &'a [f32]>) -> Vec<f64> {
    let count = maps.len() as f64;
    let mut sums = vec![0.0; DIRECTIONS];
    for map in maps {
        sums.iter_mut().zip(map).for_each(|(sum, &value)| *sum += f64::from(value));
    }
    sums.into_iter().map(|sum| sum / count).collect()
}
