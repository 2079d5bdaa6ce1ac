//! `CNN_avoid` (Section 4.2): the risk that each direction leads into an obstacle, from one image.

use serde::{Deserialize, Serialize};

use super::architecture::Architecture;
use super::scale::Scale;
use super::trunk::Trunk;
use crate::error::InvalidNetwork;

/// Directions of an avoidance map (Section 4.2: N = 180).
pub const DIRECTIONS: usize = 180;

/// Configuration of `CNN_avoid`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AvoidConfig {
    /// Trunk, which sees the image. All trunks are the encoder of FlowNetS; the DEFINet-style ones add global average pooling.
    /// FlowNetC is refused, since a single image leaves nothing to correlate.
    pub trunk: Trunk,
    /// Factor for the channels of every convolution; 1 is the published FlowNetS.
    pub width: f64,
    /// Width and height of the image in pixels.
    pub input: [usize; 2],
    /// Units of each of the two hidden fully connected layers (paper: 2048).
    pub head: usize,
}

impl AvoidConfig {
    fn scale(&self) -> Scale {
        Scale { width: self.width, input: self.input, head: self.head }
    }

    /// Checks the trunk and the ranges of the values.
    pub fn validate(&self) -> Result<(), InvalidNetwork> {
        if self.trunk == Trunk::FlowNetC {
            return Err(InvalidNetwork {
                key: "trunk",
                value: "\"flownet_c\"".to_owned(),
                expected: "a trunk that works on one image: \"flownet_s\", \"definet\" or \"definet_gap\"",
            });
        }
        self.scale().validate()
    }

    /// Returns the layers of the network. The output is linear: labels of exactly 0 or 1 are common, and a sigmoid would
    /// reach neither.
    pub fn architecture(&self) -> Architecture {
        Architecture::of_images(self.trunk, &self.scale(), DIRECTIONS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_trunks_for_single_images_are_accepted() {
        let config = |trunk| AvoidConfig { trunk, width: 0.1, input: [64, 48], head: 16 };
        for trunk in [Trunk::FlowNetS, Trunk::Definet, Trunk::DefinetGap] {
            assert_eq!(config(trunk).validate(), Ok(()));
        }
        let refused = config(Trunk::FlowNetC).validate().unwrap_err().to_string();
        assert!(
            refused.starts_with("trunk = \"flownet_c\": expected a trunk that works on one image"),
            "{refused}"
        );
    }
}
