//! What the networks see of a batch of examples; f32 begins here.

use burn::tensor::{Device, Tensor};

use crate::examples::Examples;
use crate::input;

/// What the networks see of a batch: `[batch, height, width, 3]` each, from -1 to 1.
#[derive(Debug, Clone)]
pub struct Images {
    /// The current images.
    pub current: Tensor<4>,
    /// The goal images, for `CNN_approach` alone.
    pub goal: Option<Tensor<4>>,
}

impl Images {
    /// The images of some examples.
    pub fn of(examples: &Examples, indices: &[usize], device: &Device) -> Self {
        let images = |which| {
            let pixels: Vec<_> = indices.iter().map(|&index| examples.image(index, which)).collect();
            input::tensor(&pixels, examples.input(), device)
        };
        Self { current: images(0), goal: (examples.images_each() == 2).then(|| images(1)) }
    }
}
