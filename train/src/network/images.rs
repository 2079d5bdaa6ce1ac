//! The input of a network.

use burn::tensor::Tensor;

/// A batch of images: `[batch, height, width, 3]` each, with values from -1 to 1.
#[derive(Debug, Clone)]
pub struct Images {
    /// The current images.
    pub current: Tensor<4>,
    /// The goal images, for `CNN_approach` only.
    pub goal: Option<Tensor<4>>,
}
