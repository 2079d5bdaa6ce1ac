//! Trunks: the convolutions that turn images into features.
//!
//! All trunks share the layers of one encoder, that of FlowNetS (Dosovitskiy et al. 2015), without its decoder: no flow is
//! predicted here. They differ in where the two images meet. To add a trunk, add a variant to [`Trunk`], its number of
//! [`siamese_layers`](Trunk::siamese_layers), and how it combines two images in
//! [`Architecture`](super::architecture::Architecture).

use serde::{Deserialize, Serialize};

/// A convolution of the published encoders.
pub(super) struct Layer {
    pub(super) name: &'static str,
    /// Output channels at width 1.
    pub(super) channels: usize,
    pub(super) kernel: usize,
    pub(super) stride: usize,
}

const fn layer(name: &'static str, channels: usize, kernel: usize, stride: usize) -> Layer {
    Layer { name, channels, kernel, stride }
}

/// The layers that all trunks share.
pub(super) const ENCODER: [Layer; 10] = [
    layer("conv1", 64, 7, 2),
    layer("conv2", 128, 5, 2),
    layer("conv3", 256, 5, 2),
    layer("conv3_1", 256, 3, 1),
    layer("conv4", 512, 3, 2),
    layer("conv4_1", 512, 3, 1),
    layer("conv5", 512, 3, 2),
    layer("conv5_1", 512, 3, 1),
    layer("conv6", 1024, 3, 2),
    layer("conv6_1", 1024, 3, 1),
];

/// The layer of FlowNetC that carries features of the first image past the correlation.
pub(super) const REDIRECT: Layer = layer("conv_redir", 32, 1, 1);

/// The convolutions of a network.
///
/// The last two follow DEFINet (Tokuda et al. 2021, the paper's reference \[16\]), of which the shared encoder, the
/// difference of the encoded features and the global pooling are known. Their layers and sizes are those of FlowNetS, so
/// that comparisons are about the structure. Which layers follow the difference is not known, hence two variants. With
/// convolutions after the difference, the network can see what moved where. Without them it compares the averages of two
/// images, since averaging is linear, and only the image borders still carry positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Trunk {
    /// The encoder of FlowNetS on the stacked pair.
    #[serde(rename = "flownet_s")]
    FlowNetS,
    /// The encoder of FlowNetC: shared layers, correlation of the feature maps at 1/8 of the image size, remaining layers.
    #[serde(rename = "flownet_c")]
    FlowNetC,
    /// DEFINet-style: shared layers up to 1/8 of the image size, difference, remaining layers, global average pooling.
    #[serde(rename = "definet")]
    Definet,
    /// DEFINet-style: all layers shared, difference, global average pooling.
    #[serde(rename = "definet_gap")]
    DefinetGap,
}

impl Trunk {
    /// Returns how many layers of the [`ENCODER`] see each image of a pair separately, with shared weights.
    pub(super) fn siamese_layers(self) -> usize {
        match self {
            Self::FlowNetS => 0,
            Self::FlowNetC => 3,
            Self::Definet => 4,
            Self::DefinetGap => ENCODER.len(),
        }
    }
}
