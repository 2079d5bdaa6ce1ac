//! What the networks see of a batch of examples; f32 begins here.

use burn::tensor::{Device, Tensor};

use crate::examples::Examples;
use crate::input;

/// What the networks see of a batch: `[batch, 3, height, width]` each, from 0 to 1.
#[derive(Debug, Clone)]
pub enum Images {
    /// For `CNN_approach`.
    Pair {
        /// The current images.
        current: Tensor<4>,
        /// The goal images.
        goal: Tensor<4>,
    },
    /// For `CNN_avoid`.
    Single(Tensor<4>),
}

impl Images {
    /// The images of some examples.
    pub fn of(examples: &Examples, indices: &[usize], device: &Device) -> Self {
        let images = |which| {
            let pixels: Vec<_> = indices.iter().map(|&index| examples.image(index, which)).collect();
            input::tensor(&pixels, examples.input(), device)
        };
        match examples.images_each() {
            1 => Self::Single(images(0)),
            _ => Self::Pair { current: images(0), goal: images(1) },
        }
    }
}
