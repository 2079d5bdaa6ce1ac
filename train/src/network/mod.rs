//! The networks. `CNN_approach` (Section 4.1) maps the current and the goal image to the motion between them. `CNN_avoid`
//! (Section 4.2) maps the current image to the risk of each direction.
//!
//! An [`Architecture`] lists the layers of a network. A [`Network`] holds their parameters and computes them. Tensors are
//! channels-last: `[batch, height, width, channels]`.

pub(crate) mod activation;
pub(crate) mod approach;
pub(crate) mod architecture;
pub(crate) mod avoid;
pub(crate) mod conv;
pub(crate) mod correlation;
pub(crate) mod cpu;
pub(crate) mod images;
pub(crate) mod init;
pub(crate) mod layers;
pub(crate) mod scale;
pub(crate) mod stack;
pub(crate) mod task;
pub(crate) mod trunk;

pub use self::activation::Activation;
pub use self::approach::ApproachConfig;
pub use self::architecture::{Architecture, Combine, Convolution, Flatten, FullyConnected, Symmetry};
pub use self::avoid::{AvoidConfig, DIRECTIONS};
pub use self::images::Images;
pub use self::task::Task;
pub use self::trunk::Trunk;

use burn::module::Module;
use burn::nn::Linear;
use burn::tensor::activation::leaky_relu;
use burn::tensor::{Device, Tensor};

use self::activation::SLOPE;
use self::conv::{ConvBlock, through};
use self::correlation::correlation;
use self::init::Init;
use self::layers::Layers;
use self::stack::stacked;

/// A network with its parameters.
#[derive(Module, Debug)]
pub struct Network {
    trunk: Layers<ConvBlock>,
    head: Layers<Linear>,
    #[module(skip)]
    architecture: Architecture,
}

impl Network {
    /// Returns the untrained network of an architecture: a pure function of the seed.
    pub fn new(architecture: Architecture, seed: u64, device: &Device) -> Self {
        let mut init = Init::new(seed, device);
        let trunk = architecture.convolutions().map(|layer| {
            let Convolution { name, inputs, outputs, kernel, stride, .. } = layer;
            (name.as_str(), ConvBlock::new(&mut init, [*inputs, *outputs], *kernel, *stride))
        });
        let trunk = trunk.collect();
        let head = architecture
            .head
            .iter()
            .map(|FullyConnected { name, inputs, outputs }| (name.as_str(), init.linear(*inputs, *outputs)));
        Self { trunk, head: head.collect(), architecture }
    }

    /// Computes the output.
    ///
    /// # Shapes
    /// - `images`: `[batch, height, width, 3]` each, with a goal for `CNN_approach` and without one for `CNN_avoid`
    /// - result: `[batch, outputs]`; pose changes are standardized (see
    ///   [`Standardization`](crate::data::Standardization))
    ///
    /// # Panics
    /// If the images belong to the other kind of network.
    pub fn forward(&self, images: Images) -> Tensor<2> {
        let Images { current, goal } = images;
        assert_eq!(goal.is_some(), self.architecture.combine != Combine::None, "images of the other task");
        let Some(goal) = goal else {
            return self.regress(through(self.trunk.modules(), current));
        };
        let encoded = self.encode(Tensor::cat(vec![current, goal], 0));
        let [current, goal] = halves(&encoded);
        match self.architecture.symmetry {
            Symmetry::None => self.regress(self.compare(current, goal)),
            Symmetry::Antisymmetric => {
                // Both orders of the images in one batch of twice the size.
                let swapped = Tensor::cat(vec![goal, current], 0);
                let [forward, backward] = halves(&self.regress(self.compare(encoded, swapped)));
                (forward - backward) / 2.0
            }
        }
    }

    /// Applies the convolutions that see each image separately.
    fn encode(&self, images: Tensor<4>) -> Tensor<4> {
        through(&self.trunk.modules()[..self.architecture.each_image.len()], images)
    }

    /// Combines two encoded images and applies the remaining convolutions.
    fn compare(&self, first: Tensor<4>, second: Tensor<4>) -> Tensor<4> {
        let rest = &self.trunk.modules()[self.architecture.each_image.len()..];
        match &self.architecture.combine {
            Combine::None => unreachable!("a network for single images"),
            Combine::Stack => through(rest, stacked(first, second)),
            Combine::Difference => through(rest, second - first),
            Combine::Correlation { .. } => {
                let redirected = rest[0].forward(first.clone());
                let agreement = leaky_relu(correlation(first, second), SLOPE);
                through(&rest[1..], Tensor::cat(vec![redirected, agreement], 3))
            }
        }
    }

    /// Flattens the last feature map and applies the head: leaky rectifiers between fully connected layers.
    fn regress(&self, features: Tensor<4>) -> Tensor<2> {
        let features = match self.architecture.flatten {
            Flatten::ChannelsLast => features.flatten(1, 3),
            Flatten::MeanOfChannels => features.flatten::<3>(1, 2).mean_dim(1).squeeze_dim(1),
        };
        let (output, hidden) = self.head.modules().split_last().expect("a head has an output layer");
        output.forward(hidden.iter().fold(features, |x, layer| leaky_relu(layer.forward(x), SLOPE)))
    }
}

/// Splits a batch into its two halves.
fn halves<const D: usize>(batch: &Tensor<D>) -> [Tensor<D>; 2] {
    let half = batch.dims()[0] / 2;
    [0, half].map(|begin| batch.clone().narrow(0, begin, half))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use burn::optim::{AdamWConfig, GradientsParams};
    use burn::tensor::TensorData;
    use burn_store::ModuleSnapshot;

    use super::scale::Scale;
    use super::*;
    use crate::optimizer::loss::mean_squared_error;

    const TRUNKS: [Trunk; 4] = [Trunk::FlowNetS, Trunk::FlowNetC, Trunk::Definet, Trunk::DefinetGap];

    fn config(trunk: Trunk, symmetry: Symmetry) -> ApproachConfig {
        ApproachConfig { trunk, symmetry, width: 0.1, input: [72, 48], head: 24 }
    }

    fn network(trunk: Trunk, symmetry: Symmetry, seed: u64, device: &Device) -> Network {
        Network::new(config(trunk, symmetry).architecture(), seed, device)
    }

    fn images(batch: usize, seed: u64, device: &Device) -> Tensor<4> {
        Init::new(seed, device).kaiming([batch, 48, 72, 3], 6).val()
    }

    fn output(network: &Network, current: &Tensor<4>, goal: &Tensor<4>) -> Vec<f32> {
        let images = Images { current: current.clone(), goal: Some(goal.clone()) };
        network.forward(images).into_data().try_to_vec().unwrap()
    }

    #[test]
    fn swapping_the_images_negates_exactly() {
        let device = Device::flex();
        for trunk in TRUNKS {
            let net = network(trunk, Symmetry::Antisymmetric, 3, &device);
            for batch in [1, 3, 4] {
                let (a, b) = (images(batch, 1, &device), images(batch, 2, &device));
                let forward = output(&net, &a, &b);
                assert_eq!(forward.len(), batch * 6);
                let backward: Vec<_> = output(&net, &b, &a).iter().map(|v| -v).collect();
                assert_eq!(forward, backward, "{trunk:?}");
                assert!(forward.iter().all(|v| *v != 0.0), "{trunk:?}: {forward:?}");
                assert!(output(&net, &a, &a).iter().all(|v| *v == 0.0), "{trunk:?}");
            }
            let plain = network(trunk, Symmetry::None, 3, &device);
            let (a, b) = (images(1, 1, &device), images(1, 2, &device));
            let backward = output(&plain, &b, &a);
            let sums = output(&plain, &a, &b).into_iter().zip(backward).map(|(v, w)| v + w);
            assert!(sums.into_iter().any(|sum| sum.abs() > 1e-4), "{trunk:?}");
        }
    }

    #[test]
    fn one_seed_one_network() {
        let device = Device::flex();
        let (a, b) = (images(1, 1, &device), images(1, 2, &device));
        let output = |seed| output(&network(Trunk::FlowNetS, Symmetry::None, seed, &device), &a, &b);
        assert_eq!(output(7), output(7));
        assert_ne!(output(7), output(8));
    }

    #[test]
    fn learns_eight_samples() {
        let device = Device::flex().autodiff();
        let target: Vec<f32> = (0..48).map(|i| (i as f32 * 1.7).sin()).collect();
        let target = Tensor::<2>::from_data(TensorData::new(target, [8, 6]), &device);
        let pair = Images { current: images(8, 1, &device), goal: Some(images(8, 2, &device)) };
        for trunk in TRUNKS {
            for symmetry in [Symmetry::None, Symmetry::Antisymmetric] {
                let mut net = network(trunk, symmetry, 5, &device);
                let mut optimizer = AdamWConfig::new().init();
                let mut losses = Vec::new();
                for _ in 0..60 {
                    let loss = mean_squared_error(net.forward(pair.clone()), target.clone());
                    losses.push(loss.clone().into_scalar::<f32>());
                    let gradients = GradientsParams::from_grads(loss.backward(), &net);
                    net = optimizer.step(2e-3, net, gradients);
                }
                assert!(losses[59] < 0.2 * losses[0], "{trunk:?} {symmetry:?}: {losses:?}");
            }
        }
    }

    #[test]
    fn single_images_give_linear_outputs_for_180_directions() {
        let device = Device::flex();
        let current: Tensor<4> = Init::new(2, &device).kaiming([3, 48, 64, 3], 6).val();
        let [flownet_s, definet, definet_gap] =
            [Trunk::FlowNetS, Trunk::Definet, Trunk::DefinetGap].map(|trunk| {
                let config = AvoidConfig { trunk, width: 0.1, input: [64, 48], head: 16 };
                let net = Network::new(config.architecture(), 1, &device);
                let output = net.forward(Images { current: current.clone(), goal: None });
                assert_eq!(output.dims(), [3, DIRECTIONS]);
                output.into_data().try_to_vec::<f32>().unwrap()
            });
        assert!(flownet_s.iter().any(|value| *value < 0.0), "no activation at the output");
        // At this size the last feature map of FlowNetS has a single pixel, so averaging changes nothing.
        assert_eq!([&flownet_s, &definet], [&definet, &definet_gap]);
    }

    #[test]
    fn parameters_of_the_published_encoders() {
        let scale = Scale { width: 1.0, input: [640, 480], head: 8 };
        let parameters = |trunk| {
            let architecture = Architecture::of_pairs(trunk, Symmetry::None, &scale, 6);
            let inputs = architecture.head[0].inputs;
            (Network::new(architecture, 0, &Device::flex()).trunk.num_params(), inputs)
        };
        assert_eq!(parameters(Trunk::FlowNetS), (24_050_752, 8 * 10 * 1024));
        assert_eq!(parameters(Trunk::FlowNetC), (24_549_536, 8 * 10 * 1024));
        // conv1 sees 3 channels instead of 6.
        let single = 24_050_752 - 3 * 7 * 7 * 64;
        assert_eq!([Trunk::Definet, Trunk::DefinetGap].map(parameters), [(single, 1024); 2]);
    }

    #[test]
    fn feature_maps_have_the_size_that_the_head_expects() {
        let device = Device::flex();
        for [width, height] in [[64, 48], [129, 65], [100, 70]] {
            let scale = Scale { width: 0.05, input: [width, height], head: 8 };
            for trunk in TRUNKS {
                let architecture = Architecture::of_pairs(trunk, Symmetry::None, &scale, 6);
                let image = Tensor::zeros([2, height, width, 3], &device);
                let pair = Images { current: image.clone(), goal: Some(image) };
                assert_eq!(Network::new(architecture, 0, &device).forward(pair).dims(), [2, 6], "{trunk:?}");
            }
        }
    }

    /// Names and shapes of the parameters that an architecture describes.
    fn described(architecture: &Architecture) -> BTreeMap<String, Vec<usize>> {
        let mut shapes = BTreeMap::new();
        for c in architecture.convolutions() {
            shapes.insert(format!("{}.weight", c.name), vec![c.kernel, c.kernel, c.inputs, c.outputs]);
            shapes.insert(format!("{}.bias", c.name), vec![c.outputs]);
        }
        for l in &architecture.head {
            shapes.insert(format!("{}.weight", l.name), vec![l.inputs, l.outputs]);
            shapes.insert(format!("{}.bias", l.name), vec![l.outputs]);
        }
        shapes
    }

    #[test]
    fn networks_have_the_parameters_that_their_architecture_describes() {
        let device = Device::flex();
        let check = |architecture: Architecture| {
            let snapshots = Network::new(architecture.clone(), 1, &device).collect(None, None, true);
            let found = snapshots.iter().map(|tensor| (tensor.name.clone(), tensor.shape.to_vec())).collect();
            assert_eq!(described(&architecture), found, "{:?}", architecture.trunk);
        };
        for trunk in TRUNKS {
            let (width, input, head) = (0.07, [130, 70], 5);
            let symmetry = Symmetry::Antisymmetric;
            let approach = ApproachConfig { trunk, symmetry, width, input, head };
            assert_eq!(approach.architecture().symmetry, symmetry);
            check(approach.architecture());
            let avoid = AvoidConfig { trunk, width, input, head };
            if avoid.validate().is_ok() {
                check(avoid.architecture());
            }
        }
    }
}
