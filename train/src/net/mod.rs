//! The networks: `CNN_approach` (Section 4.1) from the current and the goal image to the motion between them,
//! `CNN_avoid` (Section 4.2) from the current image to the risk of each direction.
//!
//! Tensors have their channels last: `[batch, height, width, channels]`.

mod approach;
mod avoid;
mod blueprint;
mod conv;
mod conv_cpu;
mod conv_pass;
mod conv_simd;
mod correlation;
mod correlation_cpu;
mod head;
mod init;
mod stack;
mod trunk;

pub use self::approach::{ApproachConfig, ApproachNet, Symmetry};
pub use self::avoid::{AvoidConfig, AvoidNet, DIRECTIONS};
pub use self::blueprint::{Activation, Blueprint, Combine, Convolution, Flatten, Linear};
pub(crate) use self::conv::on_cpu;
pub use self::conv::{ConvBlock, leaky_conv2d};
pub use self::head::Head;
pub use self::trunk::{FlowNetC, FlowNetS, Trunk, TrunkKind};

use burn::tensor::Tensor;

/// A network's configuration that cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{key} = {value}: expected {expected}")]
pub struct BadNetwork {
    /// The key of the configuration.
    pub key: &'static str,
    /// Its value.
    pub value: String,
    /// What is possible instead.
    pub expected: &'static str,
}

/// The size of a network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Multiplies the channels of every layer; 1 is the published FlowNetS.
    pub width: f64,
    /// Width and height of the images, pixels.
    pub input: [usize; 2],
    /// Width of the two hidden fully connected layers.
    pub head: usize,
}

impl Scale {
    /// Channels of a layer that has `full` of them at width 1.
    fn channels(&self, full: usize) -> usize {
        ((full as f64 * self.width).round() as usize).max(1)
    }

    fn validate(&self) -> Result<(), BadNetwork> {
        let bad = |key, value: String, expected| Err(BadNetwork { key, value, expected });
        if !(self.width > 0.0 && self.width <= 4.0) {
            return bad(
                "width",
                self.width.to_string(),
                "a factor above 0 and at most 4; the paper's networks have 1",
            );
        }
        if self.input.iter().any(|size| !(16..=4096).contains(size)) {
            return bad(
                "input",
                format!("{:?}", self.input),
                "[width, height] in pixels, each from 16 to 4096",
            );
        }
        if !(1..=65536).contains(&self.head) {
            return bad("head", self.head.to_string(), "1 to 65536 units; the paper has 2048");
        }
        Ok(())
    }
}

/// The two halves of a batch.
fn halves<const D: usize>(batch: &Tensor<D>) -> [Tensor<D>; 2] {
    let half = batch.dims()[0] / 2;
    [0, half].map(|begin| batch.clone().narrow(0, begin, half))
}
