//! A convolution with its parameters.

use burn::module::{Module, Param};
use burn::tensor::Tensor;

use super::leaky_conv::leaky_conv2d;
use crate::network::init::Init;

/// A convolution with bias and "same" padding, followed by a leaky rectifier.
#[derive(Module, Debug)]
pub(crate) struct ConvBlock {
    /// `[kernel, kernel, in, out]`.
    weight: Param<Tensor<4>>,
    /// `[out]`.
    bias: Param<Tensor<1>>,
    stride: usize,
}

impl ConvBlock {
    /// Returns an untrained block of `[in, out]` channels.
    pub(crate) fn new(init: &mut Init, [inputs, outputs]: [usize; 2], kernel: usize, stride: usize) -> Self {
        let weight = init.kaiming([kernel, kernel, inputs, outputs], kernel * kernel * inputs);
        Self { weight, bias: init.zeros([outputs]), stride }
    }

    /// # Shapes
    /// - `input`: `[batch, height, width, in]`
    /// - result: `[batch, ceil(height / stride), ceil(width / stride), out]`
    pub(crate) fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        leaky_conv2d(input, self.weight.val(), self.bias.val(), self.stride)
    }
}

/// Applies blocks one after the other.
pub(crate) fn through(blocks: &[ConvBlock], input: Tensor<4>) -> Tensor<4> {
    blocks.iter().fold(input, |x, block| block.forward(x))
}
