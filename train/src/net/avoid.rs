//! `CNN_avoid` (Section 4.2): how much each direction leads toward an obstacle, seen from one image.

use burn::module::Module;
use burn::tensor::{Device, Tensor};
use serde::{Deserialize, Serialize};

use super::head::Head;
use super::init::Init;
use super::trunk::Trunk;
use super::{BadNetwork, Scale};

/// Directions in an avoidance map (Section 4.2: N = 180).
pub const DIRECTIONS: usize = 180;

/// Configuration of `CNN_avoid`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AvoidConfig {
    /// Multiplies the channels of every layer; 1 is the published FlowNetS.
    pub width: f64,
    /// Width and height of the image, pixels.
    pub input: [usize; 2],
    /// Width of the two hidden fully connected layers (paper: 2048).
    pub head: usize,
}

impl AvoidConfig {
    fn scale(&self) -> Scale {
        Scale { width: self.width, input: self.input, head: self.head }
    }

    /// Checks what the types leave open.
    pub fn validate(&self) -> Result<(), BadNetwork> {
        self.scale().validate()
    }

    /// The network with its initial weights, a pure function of `seed`.
    pub fn init(&self, seed: u64, device: &Device) -> AvoidNet {
        let (scale, mut init) = (self.scale(), Init::new(seed, device));
        let trunk = Trunk::for_images(&scale, &mut init);
        let head = Head::new(trunk.features(&scale), scale.head, DIRECTIONS, &mut init);
        AvoidNet { trunk, head }
    }
}

/// `CNN_avoid` with its parameters.
#[derive(Module, Debug)]
pub struct AvoidNet {
    trunk: Trunk,
    head: Head,
}

impl AvoidNet {
    /// The output to train on. It is linear: a label of exactly 0 or 1 is common, and a sigmoid would reach neither.
    ///
    /// # Shapes
    /// - `image`: `[batch, height, width, 3]`, values from -1 to 1
    /// - result: `[batch, 180]`
    pub fn forward(&self, image: Tensor<4>) -> Tensor<2> {
        self.head.forward(self.trunk.forward(image))
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
        let net = AvoidConfig { width: 0.1, input: [64, 48], head: 16 }.init(1, &device);
        let image = Init::new(2, &device).kaiming([3, 48, 64, 3], 6).val();
        let linear = net.forward(image.clone());
        assert_eq!(linear.dims(), [3, DIRECTIONS]);
        let expected: Vec<f32> = linear.into_data().iter::<f32>().map(|v| v.clamp(0.0, 1.0)).collect();
        assert_eq!(net.avoidance_map(image).into_data().try_to_vec::<f32>().unwrap(), expected);
        assert!(expected.contains(&0.0), "the network is linear at its output");
    }
}
