//! One step of training: backward, the gradient shortened where it is too long, the optimizer.

use burn::optim::{AdamWConfig, GradientsParams, ModuleOptimizer};
use burn::tensor::Tensor;

use crate::gradient;
use crate::network::Network;

/// What a step leaves.
#[derive(Debug)]
pub struct Step {
    /// The network after it; as it was before, if loss or norm is not finite.
    pub network: Network,
    /// The loss before it.
    pub loss: f64,
    /// Norm of the gradient over all parameters, before it was shortened.
    pub gradient_norm: f64,
}

/// The optimizer of all training, `AdamW`, with its decoupled weight decay in units of the learning rate. The other
/// constants are those of Kingma and Ba (2015).
pub fn optimizer(weight_decay: f64) -> ModuleOptimizer {
    AdamWConfig::new().with_epsilon(1e-8).with_weight_decay(weight_decay as f32).init()
}

/// Moves a network against the gradient of `loss`, shortened to the norm `clip`, at learning rate `rate`.
///
/// # Shapes
/// - `loss`: `[1]`, computed with `network`
pub fn step(
    network: Network,
    optimizer: &mut ModuleOptimizer,
    loss: Tensor<1>,
    rate: f64,
    clip: f64,
) -> Step {
    let mut gradients = GradientsParams::from_grads(loss.backward(), &network);
    let loss = f64::from(loss.into_scalar::<f32>());
    let gradient_norm = gradient::norm(&network, &gradients);
    if !(loss.is_finite() && gradient_norm.is_finite()) {
        return Step { network, loss, gradient_norm };
    }
    if gradient_norm > clip {
        gradient::scale(&network, &mut gradients, clip / gradient_norm);
    }
    Step { network: optimizer.step(rate, network, gradients), loss, gradient_norm }
}
