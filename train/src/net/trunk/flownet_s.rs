//! The encoder of FlowNetS (Dosovitskiy et al. 2015), whose layers the other trunks share. Without the decoder: no
//! flow is predicted here.

use burn::module::Module;
use burn::tensor::Tensor;

use crate::net::Scale;
use crate::net::conv::ConvBlock;
use crate::net::init::Init;

/// Channels out at width 1, kernel and stride of a convolution.
pub(in crate::net) type Layer = (usize, usize, usize);

/// `conv1`, `conv2`, `conv3`, `conv3_1`, `conv4`, `conv4_1`, `conv5`, `conv5_1`, `conv6`, `conv6_1`.
pub(super) const LAYERS: [Layer; 10] = [
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

/// `layers` one after the other, the first of which sees `channels`.
pub(super) fn stack<const N: usize>(
    layers: [Layer; N],
    mut channels: usize,
    scale: &Scale,
    init: &mut Init,
) -> [ConvBlock; N] {
    layers.map(|(outputs, kernel, stride)| {
        let inputs = std::mem::replace(&mut channels, scale.channels(outputs));
        ConvBlock::new(init, [inputs, channels], kernel, stride)
    })
}

/// `images` after `layers`.
pub(super) fn through(layers: &[&ConvBlock], images: Tensor<4>) -> Tensor<4> {
    layers.iter().fold(images, |x, layer| layer.forward(x))
}

/// The layers under their published names.
#[derive(Module, Debug)]
pub struct FlowNetS {
    conv1: ConvBlock,
    conv2: ConvBlock,
    conv3: ConvBlock,
    conv3_1: ConvBlock,
    conv4: ConvBlock,
    conv4_1: ConvBlock,
    conv5: ConvBlock,
    conv5_1: ConvBlock,
    conv6: ConvBlock,
    conv6_1: ConvBlock,
}

impl FlowNetS {
    pub(in crate::net) fn new(scale: &Scale, channels: usize, init: &mut Init) -> Self {
        let [conv1, conv2, conv3, conv3_1, conv4, conv4_1, conv5, conv5_1, conv6, conv6_1] =
            stack(LAYERS, channels, scale, init);
        Self { conv1, conv2, conv3, conv3_1, conv4, conv4_1, conv5, conv5_1, conv6, conv6_1 }
    }

    /// In the order of [`LAYERS`].
    pub(super) fn layers(&self) -> [&ConvBlock; 10] {
        let Self { conv1, conv2, conv3, conv3_1, conv4, conv4_1, conv5, conv5_1, conv6, conv6_1 } = self;
        [conv1, conv2, conv3, conv3_1, conv4, conv4_1, conv5, conv5_1, conv6, conv6_1]
    }

    /// The last feature map, with its places.
    pub(in crate::net) fn flattened(&self, images: Tensor<4>) -> Tensor<2> {
        through(&self.layers(), images).flatten(1, 3)
    }

    /// The last feature map, averaged over its places.
    pub(in crate::net) fn averaged(&self, images: Tensor<4>) -> Tensor<2> {
        average(through(&self.layers(), images))
    }
}

/// The mean of a feature map over its places.
pub(super) fn average(features: Tensor<4>) -> Tensor<2> {
    features.flatten::<3>(1, 2).mean_dim(1).squeeze_dim(1)
}
