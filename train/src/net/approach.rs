//! `CNN_approach` (Section 4.1): the motion that takes the hand from where the current image was taken to where the
//! goal image was.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};

use super::head::Head;
use super::init::Init;
use super::trunk::{Trunk, TrunkKind};
use super::{BadNetwork, Scale, halves};

/// What swapping the two images does to the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Symmetry {
    /// It negates it, exactly: `v(a, b) = (g(a, b) - g(b, a)) / 2`. Then `v(a, a) = 0`, and the closed loop has no bias
    /// at its goal. Right for targets that are negated too, as the twist `log(T^-1) = -log(T)` is. Beyond the paper.
    ///
    /// It is imposed on the network as a whole. In the DEFINet-style trunks the difference of the features is negated
    /// already, but the layers after it, and the head, are not odd functions; here they become so.
    Antisymmetric,
    /// Nothing is imposed: `v(a, b) = g(a, b)`, as in the paper.
    None,
}

/// Configuration of `CNN_approach`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApproachConfig {
    /// What sees the image pair.
    pub trunk: TrunkKind,
    /// What swapping the images does.
    pub symmetry: Symmetry,
    /// Multiplies the channels of every layer; 1 is the published FlowNetS.
    pub width: f64,
    /// Width and height of the images, pixels.
    pub input: [usize; 2],
    /// Width of the two hidden fully connected layers (paper: 2048).
    pub head: usize,
}

impl ApproachConfig {
    pub(super) fn scale(&self) -> Scale {
        Scale { width: self.width, input: self.input, head: self.head }
    }

    /// Checks what the types leave open.
    pub fn validate(&self) -> Result<(), BadNetwork> {
        self.scale().validate()
    }

    /// The network with its initial weights, a pure function of `seed`.
    pub fn init(&self, seed: u64, device: &Device) -> ApproachNet {
        let (scale, mut init) = (self.scale(), Init::new(seed, device));
        let trunk = Trunk::new(self.trunk, &scale, &mut init);
        let head = Head::new(self.trunk.features(&scale), scale.head, 6, &mut init);
        ApproachNet { trunk, head, antisymmetric: self.symmetry == Symmetry::Antisymmetric }
    }
}

/// `CNN_approach` with its parameters.
#[derive(Module, Debug)]
pub struct ApproachNet {
    trunk: Trunk,
    head: Head,
    antisymmetric: bool,
}

impl ApproachNet {
    /// # Shapes
    /// - `current`, `goal`: `[batch, height, width, 3]`, values from -1 to 1
    /// - result: `[batch, 6]`, standardized (see [`Standardization`](crate::normalization::Standardization))
    pub fn forward(&self, current: Tensor<4>, goal: Tensor<4>) -> Tensor<2> {
        let encoded = self.trunk.encode(Tensor::cat(vec![current, goal], 0));
        let [current, goal] = halves(&encoded);
        if !self.antisymmetric {
            return self.head.forward(self.trunk.compare(current, goal));
        }
        // One batch of twice the size.
        let swapped = Tensor::cat(vec![goal, current], 0);
        let both = self.head.forward(self.trunk.compare(encoded, swapped));
        let [forward, backward] = halves(&both);
        (forward - backward) / 2.0
    }
}

#[cfg(test)]
mod tests {
    use burn::module::Module;
    use burn::optim::{AdamWConfig, GradientsParams};
    use burn::tensor::TensorData;

    use super::*;
    use crate::loss::mean_squared_error;

    const TRUNKS: [TrunkKind; 4] =
        [TrunkKind::FlowNetS, TrunkKind::FlowNetC, TrunkKind::Definet, TrunkKind::DefinetGap];

    fn config(trunk: TrunkKind, symmetry: Symmetry) -> ApproachConfig {
        ApproachConfig { trunk, symmetry, width: 0.1, input: [72, 48], head: 24 }
    }

    fn images(batch: usize, seed: u64, device: &Device) -> Tensor<4> {
        Init::new(seed, device).kaiming([batch, 48, 72, 3], 6).val()
    }

    fn values(tensor: Tensor<2>) -> Vec<f32> {
        tensor.into_data().try_to_vec().unwrap()
    }

    #[test]
    fn swapping_the_images_negates_exactly() {
        let device = Device::flex();
        for trunk in TRUNKS {
            let net = config(trunk, Symmetry::Antisymmetric).init(3, &device);
            for batch in [1, 3, 4] {
                let (a, b) = (images(batch, 1, &device), images(batch, 2, &device));
                let forward = net.forward(a.clone(), b.clone());
                assert_eq!(forward.dims(), [batch, 6]);
                let forward = values(forward);
                let backward: Vec<_> = values(net.forward(b, a.clone())).iter().map(|v| -v).collect();
                assert_eq!(forward, backward, "{trunk:?}");
                assert!(forward.iter().all(|v| *v != 0.0), "{trunk:?}: {forward:?}");
                assert!(values(net.forward(a.clone(), a)).iter().all(|v| *v == 0.0), "{trunk:?}");
            }
            let plain = config(trunk, Symmetry::None).init(3, &device);
            let (a, b) = (images(1, 1, &device), images(1, 2, &device));
            let sum = plain.forward(a.clone(), b.clone()) + plain.forward(b, a);
            assert!(values(sum).iter().any(|v| v.abs() > 1e-4), "{trunk:?}");
        }
    }

    #[test]
    fn one_seed_one_network() {
        let device = Device::flex();
        let (a, b) = (images(1, 1, &device), images(1, 2, &device));
        let output = |seed| {
            values(
                config(TrunkKind::FlowNetS, Symmetry::None).init(seed, &device).forward(a.clone(), b.clone()),
            )
        };
        assert_eq!(output(7), output(7));
        assert_ne!(output(7), output(8));
    }

    #[test]
    fn learns_eight_samples() {
        let device = Device::flex().autodiff();
        let target: Vec<f32> = (0..48).map(|i| (i as f32 * 1.7).sin()).collect();
        let target = Tensor::<2>::from_data(TensorData::new(target, [8, 6]), &device);
        for trunk in TRUNKS {
            for symmetry in [Symmetry::None, Symmetry::Antisymmetric] {
                let mut net = config(trunk, symmetry).init(5, &device);
                let mut optimizer = AdamWConfig::new().init();
                let mut losses = Vec::new();
                for _ in 0..60 {
                    let output = net.forward(images(8, 1, &device), images(8, 2, &device));
                    let loss = mean_squared_error(output, target.clone());
                    losses.push(loss.clone().into_scalar::<f32>());
                    let gradients = GradientsParams::from_grads(loss.backward(), &net);
                    net = optimizer.step(2e-3, net, gradients);
                }
                assert!(losses[59] < 0.2 * losses[0], "{trunk:?} {symmetry:?}: {losses:?}");
            }
        }
    }

    #[test]
    fn configuration_is_checked() {
        let text = r#"{"trunk": "flownet_s", "symmetry": "antisymmetric", "width": 0.25, "input": [128, 96], "head": 512}"#;
        let config: ApproachConfig = serde_json::from_str(text).unwrap();
        assert_eq!(config.validate(), Ok(()));
        // FlowNetS at a quarter of its channels, 2 x 2 x 256 features.
        let encoder = 1_507_600;
        let head = 1024 * 512 + 512 + 512 * 512 + 512 + 512 * 6 + 6;
        assert_eq!(config.init(0, &Device::flex()).num_params(), encoder + head);
        assert!(serde_json::from_str::<ApproachConfig>(&text.replace("head", "heads")).is_err());
        assert_eq!(ApproachConfig { width: f64::NAN, ..config.clone() }.validate().unwrap_err().key, "width");
        assert_eq!(ApproachConfig { input: [8, 96], ..config.clone() }.validate().unwrap_err().key, "input");
        assert_eq!(ApproachConfig { head: 0, ..config }.validate().unwrap_err().key, "head");
    }
}
