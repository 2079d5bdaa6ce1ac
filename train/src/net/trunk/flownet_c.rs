//! The encoder of FlowNetC (Dosovitskiy et al. 2015): each image alone to a feature map at 1/8 of its size, the maps
//! correlated, then the layers of FlowNetS. Without the decoder.

use burn::module::Module;
use burn::tensor::Tensor;
use burn::tensor::activation::leaky_relu;

use super::flownet_s::{LAYERS, stack, through};
use crate::net::Scale;
use crate::net::conv::{ConvBlock, SLOPE};
use crate::net::correlation::{DISPLACEMENTS, correlation};
use crate::net::init::Init;

/// Channels at width 1 in which the features of the first image go past the correlation.
pub(in crate::net) const REDIRECTED: usize = 32;
/// Layers that see each image alone.
pub(super) const SHARED: usize = 3;

/// The layers under their published names.
#[derive(Module, Debug)]
pub struct FlowNetC {
    conv1: ConvBlock,
    conv2: ConvBlock,
    conv3: ConvBlock,
    conv_redir: ConvBlock,
    conv3_1: ConvBlock,
    conv4: ConvBlock,
    conv4_1: ConvBlock,
    conv5: ConvBlock,
    conv5_1: ConvBlock,
    conv6: ConvBlock,
    conv6_1: ConvBlock,
}

impl FlowNetC {
    pub(super) fn new(scale: &Scale, init: &mut Init) -> Self {
        let [first, second, third, rest @ ..] = LAYERS;
        let redirected = scale.channels(REDIRECTED);
        let [conv1, conv2, conv3] = stack([first, second, third], 3, scale, init);
        let conv_redir = ConvBlock::new(init, [scale.channels(third.0), redirected], 1, 1);
        let [conv3_1, conv4, conv4_1, conv5, conv5_1, conv6, conv6_1] =
            stack(rest, redirected + DISPLACEMENTS, scale, init);
        Self { conv1, conv2, conv3, conv_redir, conv3_1, conv4, conv4_1, conv5, conv5_1, conv6, conv6_1 }
    }

    /// The feature maps of single images.
    pub(super) fn encode(&self, images: Tensor<4>) -> Tensor<4> {
        through(&[&self.conv1, &self.conv2, &self.conv3], images)
    }

    /// Two feature maps, compared and flattened.
    pub(super) fn compare(&self, first: Tensor<4>, second: Tensor<4>) -> Tensor<2> {
        let redirected = self.conv_redir.forward(first.clone());
        let agreement = leaky_relu(correlation(first, second), SLOPE);
        let Self { conv3_1, conv4, conv4_1, conv5, conv5_1, conv6, conv6_1, .. } = self;
        let layers = [conv3_1, conv4, conv4_1, conv5, conv5_1, conv6, conv6_1];
        through(&layers, Tensor::cat(vec![redirected, agreement], 3)).flatten(1, 3)
    }
}
