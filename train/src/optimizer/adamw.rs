//! `AdamW` (Loshchilov and Hutter 2019), in a single pass over memory.
//!
//! Burn's optimizer makes one pass for each of its dozen operations.

use std::mem::take;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor, TensorData};
use pulp::Arch;
use rayon::prelude::*;

use super::gradients::Gradients;
use crate::network::Network;
use crate::network::cpu::on_cpu;

/// Decay rates of the running means, and the constant that keeps the division finite (Kingma and Ba 2015).
const BETAS: [f64; 2] = [0.9, 0.999];
const EPSILON: f64 = 1e-8;
/// Elements per parallel task.
const CHUNK: usize = 16 * 1024;

/// The optimizer with its state.
#[derive(Debug)]
pub struct AdamW {
    weight_decay: f64,
    /// Steps taken.
    pub(crate) steps: usize,
    pub(crate) moments: Moments,
}

/// Running means of each parameter's gradient and of its square, flattened, in the order of the parameters.
#[derive(Module, Debug)]
pub(crate) struct Moments {
    mean: Vec<Param<Tensor<1>>>,
    square: Vec<Param<Tensor<1>>>,
}

impl AdamW {
    /// Returns the optimizer of a network before its first step.
    pub fn new(network: &Network, weight_decay: f64) -> Self {
        let mut zeros = Zeros::default();
        network.visit(&mut zeros);
        let zeros = || zeros.0.iter().map(|(len, device)| Param::from_tensor(Tensor::zeros([*len], device)));
        let moments = Moments { mean: zeros().collect(), square: zeros().collect() };
        Self { weight_decay, steps: 0, moments }
    }

    /// Takes a step against gradients of the network. Returns the network after it.
    ///
    /// # Panics
    /// If the gradients are not finite: they would destroy the parameters.
    #[must_use]
    pub fn step(&mut self, network: Network, gradients: Gradients, learning_rate: f64) -> Network {
        assert!(gradients.are_finite(), "only finite gradients can be applied");
        self.steps += 1;
        let (gradients, scale) = gradients.into_parts();
        let [mean, square] = BETAS.map(|beta| 1.0 - beta.powf(self.steps as f64));
        let factors = Factors {
            gradient: scale,
            keep: 1.0 - learning_rate * self.weight_decay,
            rate: learning_rate / mean,
            square: 1.0 / square,
        };
        let Moments { mean, square } = &mut self.moments;
        let before = take(mean).into_iter().zip(take(square));
        network.map(&mut Update { factors, gradients, before, after: &mut self.moments })
    }
}

/// Collects the number of elements and the device of each parameter.
#[derive(Default)]
struct Zeros(Vec<(usize, Device)>);

impl ModuleVisitor for Zeros {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let value = param.val().inner();
        self.0.push((value.shape().num_elements(), value.device()));
    }
}

/// `parameter = keep * parameter - rate * mean / (sqrt(square * mean of squares) + epsilon)`
#[derive(Clone, Copy)]
struct Factors {
    gradient: f64,
    keep: f64,
    rate: f64,
    square: f64,
}

struct Update<'a, B> {
    factors: Factors,
    gradients: GradientsParams,
    before: B,
    after: &'a mut Moments,
}

impl<B: Iterator<Item = (Param<Tensor<1>>, Param<Tensor<1>>)>> ModuleMapper for Update<'_, B> {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let (id, value, mapper) = param.consume();
        let (mean, square) = self.before.next().expect("moments of the same network");
        let Some(gradient) = self.gradients.remove::<D>(id) else {
            self.after.mean.push(mean);
            self.after.square.push(square);
            return Param::from_mapped_value(id, value, mapper);
        };
        let shape = value.dims();
        let [(mean_id, mean, _), (square_id, square, _)] = [mean, square].map(Param::consume);
        let tensors = [value.inner().flatten(0, D - 1), gradient.flatten(0, D - 1), mean, square];
        let [value, mean, square] = if on_cpu(&tensors[0].device()) {
            self.factors.fused(tensors)
        } else {
            self.factors.composed(tensors)
        };
        self.after.mean.push(Param::initialized(mean_id, mean));
        self.after.square.push(Param::initialized(square_id, square));
        let value = Tensor::from_inner(value.reshape(shape)).require_grad();
        Param::from_mapped_value(id, value, mapper)
    }
}

impl Factors {
    /// Updates parameter and moments with Burn's operations. Takes parameter, gradient and moments.
    fn composed(self, [value, gradient, mean, square]: [Tensor<1>; 4]) -> [Tensor<1>; 3] {
        let gradient = gradient * self.gradient;
        let mean = mean * BETAS[0] + gradient.clone() * (1.0 - BETAS[0]);
        let square = square * BETAS[1] + gradient.square() * (1.0 - BETAS[1]);
        let change = mean.clone() * self.rate / ((square.clone() * self.square).sqrt() + EPSILON);
        [value * self.keep - change, mean, square]
    }

    /// Updates parameter and moments in a single pass, in place unless the tensors are shared.
    fn fused(self, tensors: [Tensor<1>; 4]) -> [Tensor<1>; 3] {
        let device = tensors[0].device();
        let [mut value, mut gradient, mut mean, mut square] = tensors.map(Tensor::into_data);
        let chunks = [&mut value, &mut mean, &mut square, &mut gradient].map(|data: &mut TensorData| {
            data.as_mut_slice::<f32>().expect("tensors of the CPU are f32").par_chunks_mut(CHUNK)
        });
        let [value_chunks, mean_chunks, square_chunks, gradient_chunks] = chunks;
        let chunks = value_chunks.zip(mean_chunks).zip(square_chunks.zip(gradient_chunks));
        chunks.for_each(|((value, mean), (square, gradient))| {
            Arch::new().dispatch(|| self.update(value, gradient, mean, square));
        });
        [value, mean, square].map(|data| Tensor::from_data(data, &device))
    }

    #[allow(
        clippy::inline_always,
        reason = "only inlined code is compiled for the machine's vector instructions"
    )]
    #[inline(always)]
    fn update(self, value: &mut [f32], gradient: &[f32], mean: &mut [f32], square: &mut [f32]) {
        let [factor, keep, rate, scale] =
            [self.gradient, self.keep, self.rate, self.square].map(|f| f as f32);
        let [beta1, beta2] = BETAS.map(|beta| beta as f32);
        let [rest1, rest2] = BETAS.map(|beta| (1.0 - beta) as f32);
        for (((value, gradient), mean), square) in value.iter_mut().zip(gradient).zip(mean).zip(square) {
            let gradient = factor * gradient;
            *mean = beta1 * *mean + rest1 * gradient;
            *square = beta2 * *square + rest2 * gradient * gradient;
            *value = keep * *value - rate * *mean / ((scale * *square).sqrt() + EPSILON as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use burn::optim::AdamWConfig;
    use burn::tensor::Tolerance;
    use datagen::Kind;

    use super::*;
    use crate::config::tests::tiny;
    use crate::network::Images;

    const RATE: f64 = 1e-2;
    const DECAY: f64 = 0.1;

    fn start() -> (Network, AdamW) {
        let task = tiny(Kind::Avoidance).task().unwrap();
        let network = Network::new(task.architecture(), 1, &Device::default().autodiff());
        let optimizer = AdamW::new(&network, DECAY);
        (network, optimizer)
    }

    fn loss(network: &Network, value: f32) -> Tensor<1> {
        let device = Device::default().autodiff();
        let images = Images { current: Tensor::ones([2, 24, 32, 3], &device) * value, goal: None };
        network.forward(images).square().mean()
    }

    fn parameters(network: &Network) -> Vec<f32> {
        struct Values(Vec<f32>);
        impl ModuleVisitor for Values {
            fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
                self.0.extend(param.val().into_data().iter::<f32>());
            }
        }
        let mut values = Values(Vec::new());
        network.visit(&mut values);
        values.0
    }

    #[test]
    fn agrees_with_the_optimizer_of_burn() {
        let ((mut ours, mut optimizer), (mut theirs, _)) = (start(), start());
        let mut oracle =
            AdamWConfig::new().with_epsilon(EPSILON as f32).with_weight_decay(DECAY as f32).init();
        for value in [0.2, 0.9, 0.4, 0.7] {
            let gradients = GradientsParams::from_grads(loss(&theirs, value).backward(), &theirs);
            theirs = oracle.step(RATE, theirs, gradients);
            let gradients = Gradients::backward(&ours, loss(&ours, value));
            ours = optimizer.step(ours, gradients, RATE);
        }
        let (ours, theirs) = (parameters(&ours), parameters(&theirs));
        assert_ne!(ours, parameters(&start().0));
        for (ours, theirs) in ours.iter().zip(&theirs) {
            assert!((ours - theirs).abs() < 1e-5, "{ours} {theirs}");
        }
    }

    #[test]
    fn the_single_pass_equals_the_operations() {
        let tensor = |k: f32| Tensor::from_floats([0.3 * k, -0.2 * k, 0.0, 1.5], &Device::default());
        let factors = Factors { gradient: 0.5, keep: 0.9, rate: 0.01, square: 3.0 };
        let tensors = || [tensor(1.0), tensor(-2.0), tensor(0.3), tensor(2.0).square()];
        for (fused, composed) in factors.fused(tensors()).into_iter().zip(factors.composed(tensors())) {
            fused.into_data().assert_approx_eq::<f32>(&composed.into_data(), Tolerance::rel_abs(1e-6, 1e-7));
        }
    }

    #[test]
    fn a_long_gradient_keeps_its_direction() {
        // The first step of Adam is independent of the length of the gradient, but its moments are not.
        let means = |clip| {
            let (network, mut optimizer) = start();
            let gradients = Gradients::backward(&network, loss(&network, 0.5)).clipped(clip);
            let norm = gradients.norm();
            let _ = optimizer.step(network, gradients, RATE);
            let means = optimizer.moments.mean.iter().map(|mean| mean.val().into_data().try_to_vec::<f32>());
            (norm, means.flat_map(Result::unwrap).collect::<Vec<_>>())
        };
        let (norm, free) = means(1e9);
        let (_, clipped) = means(norm / 4.0);
        assert!(norm > 0.0);
        let length = |v: &[f32]| v.iter().map(|v| f64::from(v * v)).sum::<f64>().sqrt();
        assert_relative_eq!(length(&free), 0.1 * norm, max_relative = 1e-5);
        for (free, clipped) in free.iter().zip(&clipped) {
            assert_relative_eq!(0.25 * free, *clipped, max_relative = 1e-5);
        }
    }

    #[test]
    #[should_panic(expected = "finite")]
    fn gradients_that_are_not_finite_are_never_applied() {
        let (network, mut optimizer) = start();
        let bad = Gradients::backward(&network, loss(&network, 1.0) * f32::NAN);
        assert!(bad.loss().is_nan() && !bad.are_finite());
        let _ = optimizer.step(network, bad, RATE);
    }
}
