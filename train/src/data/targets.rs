//! The labels of a batch as targets of the network.

use burn::tensor::{Device, Tensor, TensorData};

use super::examples::{Examples, Labels};
use super::standardization::Standardization;
use crate::error::{Error, Result};
use crate::network::architecture::Symmetry;
use crate::network::avoid::DIRECTIONS;
use crate::network::task::Task;

/// The labels of all examples, with statistics of the training examples.
pub(crate) enum Targets<'a> {
    /// Pose changes.
    PoseChanges {
        /// Labels in meters and radians.
        labels: &'a [[f64; 6]],
        /// Standardization of the targets.
        standardization: Standardization,
    },
    /// Avoidance maps.
    AvoidanceMaps {
        /// Concatenated maps.
        values: &'a [f32],
        /// Mean map of the training examples.
        mean: Vec<f64>,
    },
}

impl<'a> Targets<'a> {
    /// Computes the statistics of the training examples. A `given` standardization replaces theirs.
    ///
    /// # Panics
    /// If the examples belong to the other task.
    pub(crate) fn new(
        task: &Task,
        examples: &'a Examples,
        training: &[usize],
        given: Option<Standardization>,
    ) -> Result<Self> {
        match (task, examples.labels()) {
            (Task::Approach { network, .. }, Labels::PoseChanges(labels)) => {
                let selected: Vec<_> = training.iter().map(|&index| labels[index]).collect();
                let standardization = match network.symmetry {
                    Symmetry::Antisymmetric => Standardization::antisymmetric(&selected),
                    Symmetry::None => Standardization::centered(&selected),
                };
                let standardization = standardization.ok_or(Error::LabelsNotFinite)?;
                Ok(Self::PoseChanges { labels, standardization: given.unwrap_or(standardization) })
            }
            (Task::Avoidance { .. }, Labels::AvoidanceMaps(values)) => {
                let mean = mean_map(training.iter().map(|&index| map(values, index)));
                // A sum is finite only if all its terms are.
                let finite = mean.iter().all(|value| value.is_finite());
                if finite { Ok(Self::AvoidanceMaps { values, mean }) } else { Err(Error::LabelsNotFinite) }
            }
            _ => panic!("examples of the other task"),
        }
    }

    /// Returns the standardization of the output. Avoidance maps have none.
    pub(crate) fn standardization(&self) -> Option<&Standardization> {
        match self {
            Self::PoseChanges { standardization, .. } => Some(standardization),
            Self::AvoidanceMaps { .. } => None,
        }
    }

    /// Returns the targets of examples.
    ///
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
}

/// Returns the avoidance map of an example.
pub(crate) fn map(values: &[f32], index: usize) -> &[f32] {
    &values[index * DIRECTIONS..(index + 1) * DIRECTIONS]
}

/// Returns the mean of each direction.
fn mean_map<'a>(maps: impl ExactSizeIterator<Item = &'a [f32]>) -> Vec<f64> {
    let count = maps.len() as f64;
    let mut sums = vec![0.0; DIRECTIONS];
    for map in maps {
        sums.iter_mut().zip(map).for_each(|(sum, &value)| *sum += f64::from(value));
    }
    sums.into_iter().map(|sum| sum / count).collect()
}
