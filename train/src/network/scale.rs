//! The size of a network.

use crate::error::InvalidNetwork;

/// The size of a network.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scale {
    /// Factor for the channels of every convolution; 1 is the published FlowNetS.
    pub(crate) width: f64,
    /// Width and height of the images in pixels.
    pub(crate) input: [usize; 2],
    /// Units of each of the two hidden fully connected layers.
    pub(crate) head: usize,
}

impl Scale {
    /// Returns the channels of a layer that has `full` of them at width 1.
    pub(super) fn channels(&self, full: usize) -> usize {
        ((full as f64 * self.width).round() as usize).max(1)
    }

    /// Checks the ranges of the values.
    pub(super) fn validate(&self) -> Result<(), InvalidNetwork> {
        let bad = |key, value: String, expected| Err(InvalidNetwork { key, value, expected });
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
