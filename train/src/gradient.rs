//! The norm of the gradient over all parameters together, and gradients shortened to a norm.
//!
//! Burn clips each parameter by its own norm, which changes the gradient's direction; this does not.

use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::Tensor;

use crate::network::Network;

/// Euclidean norm over all parameters.
pub(crate) fn norm(network: &Network, gradients: &GradientsParams) -> f64 {
    let mut squares = Squares { gradients, sums: Vec::new() };
    network.visit(&mut squares);
    f64::from(Tensor::cat(squares.sums, 0).sum().into_scalar::<f32>()).sqrt()
}

/// Multiplies all gradients by one factor.
pub(crate) fn scale(network: &Network, gradients: &mut GradientsParams, factor: f64) {
    network.visit(&mut Scaling { gradients, factor });
}

struct Squares<'a> {
    gradients: &'a GradientsParams,
    sums: Vec<Tensor<1>>,
}

impl ModuleVisitor for Squares<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.get::<D>(param.id) {
            self.sums.push(gradient.square().sum());
        }
    }
}

struct Scaling<'a> {
    gradients: &'a mut GradientsParams,
    factor: f64,
}

impl ModuleVisitor for Scaling<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.remove::<D>(param.id) {
            self.gradients.register(param.id, gradient * self.factor);
        }
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use burn::tensor::Device;
    use datagen::Kind;

    use super::*;
    use crate::batch::Images;
    use crate::config::tests::tiny;

    #[test]
    fn the_norm_is_over_all_parameters_and_scales_with_them() {
        let device = Device::flex().autodiff();
        let network = Network::new(&tiny(Kind::Avoidance).task().unwrap(), 1, &device);
        let images = Images { current: Tensor::ones([2, 24, 32, 3], &device) * -0.5, goal: None };
        // The gradient of the sum of all outputs with respect to each of the last biases is the batch size, so the
        // norm is at least that of 180 twos; all other gradients are more.
        let backward = network.forward(images).sum().backward();
        let mut gradients = GradientsParams::from_grads(backward, &network);
        let whole = norm(&network, &gradients);
        assert!(whole > 2.0 * 180_f64.sqrt());
        scale(&network, &mut gradients, 0.25);
        assert_relative_eq!(norm(&network, &gradients), 0.25 * whole, max_relative = 1e-5);
    }
}
