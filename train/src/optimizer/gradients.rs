//! Gradients of the loss, clipped by their norm over all parameters.
//!
//! Burn's optimizer clips each parameter by its own norm, which changes the direction of the gradient.

use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::Tensor;

use crate::network::Network;

/// The gradients of a loss with respect to the parameters of a network.
#[derive(Debug)]
pub struct Gradients {
    by_parameter: GradientsParams,
    loss: f64,
    norm: f64,
    /// Factor that clips the gradients. The optimizer applies it, which saves a pass over memory.
    scale: f64,
}

impl Gradients {
    /// Computes the gradients of `loss`, which was computed with the network.
    ///
    /// # Shapes
    /// - `loss`: `[1]`
    pub fn backward(network: &Network, loss: Tensor<1>) -> Self {
        let by_parameter = GradientsParams::from_grads(loss.backward(), network);
        let loss = f64::from(loss.into_scalar::<f32>());
        let norm = norm(network, &by_parameter);
        Self { by_parameter, loss, norm, scale: 1.0 }
    }

    /// Scales the gradients down to the norm `max_norm` if they are longer.
    #[must_use]
    pub fn clipped(mut self, max_norm: f64) -> Self {
        self.scale = if self.norm > max_norm { max_norm / self.norm } else { 1.0 };
        self
    }

    /// Returns whether loss and norm are finite. Other gradients must not be applied.
    pub fn are_finite(&self) -> bool {
        self.loss.is_finite() && self.norm.is_finite()
    }

    /// Returns the loss.
    pub fn loss(&self) -> f64 {
        self.loss
    }

    /// Returns the Euclidean norm over all parameters, before clipping.
    pub fn norm(&self) -> f64 {
        self.norm
    }

    /// Returns the gradient of each parameter before clipping, and the factor that clips it.
    pub(crate) fn into_parts(self) -> (GradientsParams, f64) {
        (self.by_parameter, self.scale)
    }
}

/// Returns the Euclidean norm over all parameters. Reads from the device once.
fn norm(network: &Network, gradients: &GradientsParams) -> f64 {
    let mut squares = SumsOfSquares { gradients, sums: Vec::new() };
    network.visit(&mut squares);
    Tensor::cat(squares.sums, 0).into_data().iter::<f32>().map(f64::from).sum::<f64>().sqrt()
}

struct SumsOfSquares<'a> {
    gradients: &'a GradientsParams,
    sums: Vec<Tensor<1>>,
}

impl ModuleVisitor for SumsOfSquares<'_> {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        if let Some(gradient) = self.gradients.get::<D>(param.id) {
            self.sums.push(gradient.square().sum());
        }
    }
}
