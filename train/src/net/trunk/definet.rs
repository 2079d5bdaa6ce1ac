//! The baseline, DEFINet-style. Of DEFINet (Tokuda et al. 2021, the paper's reference \[16\]) are known the shared
//! encoder, the difference of the encoded features and the global pooling; layers and sizes here are those of
//! FlowNetS, so that the comparison is about the structure.
//!
//! Which layers follow the difference is not known, so there are two variants. With convolutions after it the network can
//! see what moved where. Without, as averaging is linear, it compares the averages of two images, and only their borders
//! still tell positions.

use burn::tensor::Tensor;

use super::flownet_s::{FlowNetS, LAYERS, average, through};

/// Layers that see each image alone in `definet`: up to `conv3_1`, at 1/8 of the size.
pub(super) const EARLY: usize = 4;
/// The same in `definet_gap`: all.
pub(super) const LATE: usize = LAYERS.len();

/// The features of single images after the first `shared` layers.
pub(super) fn encode(layers: &FlowNetS, shared: usize, images: Tensor<4>) -> Tensor<4> {
    through(&layers.layers()[..shared], images)
}

/// The difference of features, through the other layers, averaged.
pub(super) fn compare(layers: &FlowNetS, shared: usize, [first, second]: [Tensor<4>; 2]) -> Tensor<2> {
    average(through(&layers.layers()[shared..], second - first))
}
