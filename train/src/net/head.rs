//! The fully connected head that all networks share.

use burn::module::Module;
use burn::nn::Linear;
use burn::tensor::Tensor;
use burn::tensor::activation::leaky_relu;

use super::conv::SLOPE;
use super::init::Init;

/// Linear, leaky rectifier, linear, leaky rectifier, linear.
#[derive(Module, Debug)]
pub struct Head {
    hidden1: Linear,
    hidden2: Linear,
    output: Linear,
}

impl Head {
    /// A head from `inputs` features over two hidden layers of `hidden` units to `outputs`.
    pub(super) fn new(inputs: usize, hidden: usize, outputs: usize, init: &mut Init) -> Self {
        Self {
            hidden1: init.linear(inputs, hidden),
            hidden2: init.linear(hidden, hidden),
            output: init.linear(hidden, outputs),
        }
    }

    /// # Shapes
    /// - `features`: `[batch, inputs]`
    /// - result: `[batch, outputs]`
    pub fn forward(&self, features: Tensor<2>) -> Tensor<2> {
        let hidden = leaky_relu(self.hidden1.forward(features), SLOPE);
        let hidden = leaky_relu(self.hidden2.forward(hidden), SLOPE);
        self.output.forward(hidden)
    }
}
