//! The baseline, DEFINet-style. Of DEFINet (Tokuda et al. 2021, the paper's reference \[16\]) are known the shared
//! encoder, the difference of the encoded features and the global pooling; layers and sizes here are those of
//! FlowNetS, so that the comparison is about the structure. The convolutions after the difference are needed:
//! averaging is linear, and "difference, then average" alone would discard where anything is.

use burn::module::Module;
use burn::tensor::Tensor;

use super::flownet_s::{LAYERS, stack};
use crate::net::conv::ConvBlock;
use crate::net::init::Init;
use crate::net::{Scale, halves};

/// Layers up to `conv3_1` (1/8 of the size) see each image alone.
const SHARED: usize = 4;

/// Shared encoder, difference, convolutions, global average pooling.
#[derive(Module, Debug)]
pub struct Definet {
    encoder: Vec<ConvBlock>,
    layers: Vec<ConvBlock>,
}

impl Definet {
    pub(super) fn new(scale: &Scale, init: &mut Init) -> Self {
        let encoded = scale.channels(LAYERS[SHARED - 1].0);
        Self {
            encoder: stack(&LAYERS[..SHARED], 3, scale, init),
            layers: stack(&LAYERS[SHARED..], encoded, scale, init),
        }
    }

    pub(super) fn features(scale: &Scale) -> usize {
        scale.channels(LAYERS[9].0)
    }

    pub(super) fn forward(&self, pair: Tensor<4>) -> Tensor<2> {
        let images = Tensor::cat(pair.split(3, 3), 0);
        let encoded = self.encoder.iter().fold(images, |x, layer| layer.forward(x));
        let [current, goal] = halves(&encoded);
        let features = self.layers.iter().fold(goal - current, |x, layer| layer.forward(x));
        features.flatten::<3>(1, 2).mean_dim(1).squeeze_dim(1)
    }
}
