//! The encoder of FlowNetS (Dosovitskiy et al. 2015), whose layers the other trunks share. Without the decoder: no
//! flow is predicted here.

use burn::module::Module;
use burn::tensor::Tensor;

use crate::net::Scale;
use crate::net::conv::ConvBlock;
use crate::net::init::Init;

/// Channels out at width 1, kernel and stride of `conv1`, `conv2`, `conv3`, `conv3_1`, `conv4`, `conv4_1`, `conv5`,
/// `conv5_1`, `conv6`, `conv6_1`.
pub(super) const LAYERS: [(usize, usize, usize); 10] = [
    (64, 7, 2),
    (128, 5, 2),
    (256, 5, 2),
    (256, 3, 1),
    (512, 3, 2),
    (512, 3, 1),
    (512, 3, 2),
    (512, 3, 1),
    (1024, 3, 2),
    (1024, 3, 1),
];

/// By how much the six layers of stride 2 shrink an image.
const SHRINK: usize = 64;

/// `layers` one after the other, the first of which sees `channels`.
pub(super) fn stack(
    layers: &[(usize, usize, usize)],
    mut channels: usize,
    scale: &Scale,
    init: &mut Init,
) -> Vec<ConvBlock> {
    let mut blocks = Vec::new();
    for &(outputs, kernel, stride) in layers {
        let outputs = scale.channels(outputs);
        blocks.push(ConvBlock::new(init, [channels, outputs], kernel, stride));
        channels = outputs;
    }
    blocks
}

/// All layers on the stacked images, flattened.
#[derive(Module, Debug)]
pub struct FlowNetS {
    layers: Vec<ConvBlock>,
}

impl FlowNetS {
    pub(super) fn new(scale: &Scale, channels: usize, init: &mut Init) -> Self {
        Self { layers: stack(&LAYERS, channels, scale, init) }
    }

    pub(super) fn features(scale: &Scale) -> usize {
        let [width, height] = scale.input.map(|size| size.div_ceil(SHRINK));
        width * height * scale.channels(LAYERS[9].0)
    }

    pub(super) fn forward(&self, images: Tensor<4>) -> Tensor<2> {
        self.layers.iter().fold(images, |x, layer| layer.forward(x)).flatten(1, 3)
    }
}

#[cfg(test)]
mod tests {
    use burn::module::Module;
    use burn::tensor::Device;

    use super::*;

    #[test]
    fn parameters_of_the_published_encoder() {
        let scale = Scale { width: 1.0, input: [640, 480], head: 2048 };
        let trunk = FlowNetS::new(&scale, 6, &mut Init::new(0, &Device::flex()));
        assert_eq!(trunk.num_params(), 24_050_752);
        assert_eq!(FlowNetS::features(&scale), 8 * 10 * 1024);
    }

    #[test]
    fn features_are_counted_as_they_come() {
        let device = Device::flex();
        for input in [[64, 48], [129, 65], [100, 70]] {
            let scale = Scale { width: 0.05, input, head: 8 };
            let trunk = FlowNetS::new(&scale, 3, &mut Init::new(0, &device));
            let features = trunk.forward(Tensor::zeros([2, input[1], input[0], 3], &device));
            assert_eq!(features.dims(), [2, FlowNetS::features(&scale)]);
        }
    }
}
