//! Initial parameters: a pure function of the seed, the same on every device.
//!
//! Burn's own initializers draw from the generator of the device. It differs between backends, is shared by all threads of
//! the process, and is drawn from in the order in which parameters are first used.

use burn::module::Param;
use burn::nn::Linear;
use burn::tensor::{Device, Tensor, TensorData};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::activation::SLOPE;

/// Draws the parameters of a network, layer by layer.
#[derive(Debug)]
pub(crate) struct Init {
    random: ChaCha8Rng,
    device: Device,
}

impl Init {
    /// Starts a stream of parameters on `device`.
    pub(crate) fn new(seed: u64, device: &Device) -> Self {
        Self { random: ChaCha8Rng::seed_from_u64(seed), device: device.clone() }
    }

    /// Draws weights that preserve the variance of activations through a leaky rectifier (He et al. 2015, "MSRA"), uniformly
    /// distributed. Each output sums over `fan_in` inputs.
    pub(crate) fn kaiming<const D: usize>(&mut self, shape: [usize; D], fan_in: usize) -> Param<Tensor<D>> {
        let bound = (6.0 / ((1.0 + SLOPE * SLOPE) * fan_in as f64)).sqrt() as f32;
        let count = shape.iter().product();
        let values: Vec<f32> = (0..count).map(|_| self.random.random_range(-bound..bound)).collect();
        Param::from_tensor(Tensor::from_data(TensorData::new(values, shape), &self.device))
    }

    /// Returns parameters that start at zero.
    pub(crate) fn zeros<const D: usize>(&mut self, shape: [usize; D]) -> Param<Tensor<D>> {
        Param::from_tensor(Tensor::zeros(shape, &self.device))
    }

    /// Returns a fully connected layer.
    pub(crate) fn linear(&mut self, inputs: usize, outputs: usize) -> Linear {
        Linear { weight: self.kaiming([inputs, outputs], inputs), bias: Some(self.zeros([outputs])) }
    }
}
