//! `CNN_approach` (Section 4.1): the motion of the hand that turns the current image into the goal image.

use serde::{Deserialize, Serialize};

use super::architecture::{Architecture, Symmetry};
use super::scale::Scale;
use super::trunk::Trunk;
use crate::error::InvalidNetwork;

/// Components of a pose change.
const AXES: usize = 6;

/// Configuration of `CNN_approach`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ApproachConfig {
    /// Trunk, which sees the image pair.
    pub trunk: Trunk,
    /// Effect of swapping the images.
    pub symmetry: Symmetry,
    /// Factor for the channels of every convolution; 1 is the published FlowNetS.
    pub width: f64,
    /// Width and height of the images in pixels.
    pub input: [usize; 2],
    /// Units of each of the two hidden fully connected layers (paper: 2048).
    pub head: usize,
}

impl ApproachConfig {
    fn scale(&self) -> Scale {
        Scale { width: self.width, input: self.input, head: self.head }
    }

    /// Checks the ranges of the values.
    pub fn validate(&self) -> Result<(), InvalidNetwork> {
        self.scale().validate()
    }

    /// Returns the layers of the network.
    pub fn architecture(&self) -> Architecture {
        Architecture::of_pairs(self.trunk, self.symmetry, &self.scale(), AXES)
    }
}

#[cfg(test)]
mod tests {
    use burn::module::Module;
    use burn::tensor::Device;

    use super::*;
    use crate::network::Network;

    #[test]
    fn configuration_is_checked() {
        let text = r#"{"trunk": "flownet_s", "symmetry": "antisymmetric", "width": 0.25, "input": [128, 96], "head": 512}"#;
        let config: ApproachConfig = serde_json::from_str(text).unwrap();
        assert_eq!(config.validate(), Ok(()));
        // FlowNetS at a quarter of its channels, 2 x 2 x 256 features.
        let encoder = 1_507_600;
        let head = 1024 * 512 + 512 + 512 * 512 + 512 + 512 * 6 + 6;
        let network = Network::new(config.architecture(), 0, &Device::flex());
        assert_eq!(network.num_params(), encoder + head);
        assert!(serde_json::from_str::<ApproachConfig>(&text.replace("head", "heads")).is_err());
        assert_eq!(ApproachConfig { width: f64::NAN, ..config.clone() }.validate().unwrap_err().key, "width");
        assert_eq!(ApproachConfig { input: [8, 96], ..config.clone() }.validate().unwrap_err().key, "input");
        assert_eq!(ApproachConfig { head: 0, ..config }.validate().unwrap_err().key, "head");
    }
}
