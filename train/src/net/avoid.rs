//! `CNN_avoid` (Section 4.2): how much each direction leads toward an obstacle, seen from one image.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};

use super::head::Head;
use super::init::Init;
use super::trunk::{FlowNetS, TrunkKind};
use super::{BadNetwork, Scale};

/// Directions in an avoidance map (Section 4.2: N = 180).
pub const DIRECTIONS: usize = 180;

/// Configuration of `CNN_avoid`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AvoidConfig {
    /// What sees the image: the layers of FlowNetS, and after those of the DEFINet-style trunks a global pooling.
    /// FlowNetC has nothing to correlate.
    pub trunk: TrunkKind,
    /// Multiplies the channels of every layer; 1 is the published FlowNetS.
    pub width: f64,
    /// Width and height of the image, pixels.
    pub input: [usize; 2],
    /// Width of the two hidden fully connected layers (paper: 2048).
    pub head: usize,
}

impl AvoidConfig {
    pub(super) fn scale(&self) -> Scale {
        Scale { width: self.width, input: self.input, head: self.head }
    }

    /// Checks what the types leave open.
    pub fn validate(&self) -> Result<(), BadNetwork> {
        if self.trunk == TrunkKind::FlowNetC {
            return Err(BadNetwork {
                key: "trunk",
                value: "\"flownet_c\"".to_owned(),
                expected: "a trunk that can look at one image, which is all that CNN_avoid has: \"flownet_s\", \
                           \"definet\" or \"definet_gap\"",
            });
        }
        self.scale().validate()
    }

    /// The network with its initial weights, a pure function of `seed`.
    pub fn init(&self, seed: u64, device: &Device) -> AvoidNet {
        let (scale, mut init) = (self.scale(), Init::new(seed, device));
        let trunk = FlowNetS::new(&scale, 3, &mut init);
        let head = Head::new(self.trunk.features(&scale), scale.head, DIRECTIONS, &mut init);
        AvoidNet { trunk, averaged: self.trunk != TrunkKind::FlowNetS, head }
    }
}

/// `CNN_avoid` with its parameters.
#[derive(Module, Debug)]
pub struct AvoidNet {
    trunk: FlowNetS,
    averaged: bool,
    head: Head,
}

impl AvoidNet {
    /// The output to train on. It is linear: a label of exactly 0 or 1 is common, and a sigmoid would reach neither.
    ///
    /// # Shapes
    /// - `image`: `[batch, height, width, 3]`, values from -1 to 1
    /// - result: `[batch, 180]`
    pub fn forward(&self, image: Tensor<4>) -> Tensor<2> {
        let features = if self.averaged { self.trunk.averaged(image) } else { self.trunk.flattened(image) };
        self.head.forward(features)
    }

    /// The avoidance map: [`forward`](Self::forward) clamped to the range 0..=1 of Eq. (1).
    pub fn avoidance_map(&self, image: Tensor<4>) -> Tensor<2> {
        self.forward(image).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_have_180_values_from_zero_to_one() {
        let device = Device::flex();
        let image = Init::new(2, &device).kaiming([3, 48, 64, 3], 6).val();
        let config = |trunk| AvoidConfig { trunk, width: 0.1, input: [64, 48], head: 16 };
        let mut maps = Vec::new();
        for trunk in [TrunkKind::FlowNetS, TrunkKind::Definet, TrunkKind::DefinetGap] {
            assert_eq!(config(trunk).validate(), Ok(()));
            let net = config(trunk).init(1, &device);
            let linear = net.forward(image.clone());
            assert_eq!(linear.dims(), [3, DIRECTIONS]);
            let expected: Vec<f32> = linear.into_data().iter::<f32>().map(|v| v.clamp(0.0, 1.0)).collect();
            let map = net.avoidance_map(image.clone()).into_data().try_to_vec::<f32>().unwrap();
            assert_eq!(map, expected);
            assert!(map.contains(&0.0), "the network is linear at its output");
            maps.push(map);
        }
        // At this size FlowNetS has a single place to average over.
        assert_eq!([&maps[0], &maps[1]], [&maps[1], &maps[2]]);
        let refused = config(TrunkKind::FlowNetC).validate().unwrap_err().to_string();
        assert!(refused.starts_with("trunk = \"flownet_c\": expected a trunk that can look at one image"));
    }
}
