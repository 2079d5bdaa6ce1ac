//! The layers of a network, in one description from which everything else follows: the [`Network`](super::Network), the
//! names of its parameters in files, and the `network` entry of a checkpoint's `config.json`.

use serde::{Deserialize, Serialize};

use super::activation::Activation;
use super::correlation::displacement::{DISPLACEMENTS, REACH, STRIDE};
use super::scale::Scale;
use super::trunk::{ENCODER, Layer, REDIRECT, Trunk};

/// Color channels of an image.
const COLORS: usize = 3;

/// The layers of a network in the order of computation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Architecture {
    /// The trunk.
    pub trunk: Trunk,
    /// Convolutions that see each image separately.
    pub each_image: Vec<Convolution>,
    /// Combination of two images, or of their feature maps, into one feature map.
    pub combine: Combine,
    /// Convolutions after the combination.
    pub combined: Vec<Convolution>,
    /// Conversion of the last feature map to a vector.
    pub flatten: Flatten,
    /// Fully connected layers, `y = x W + b`.
    pub head: Vec<FullyConnected>,
    /// Activation after every layer except the last.
    pub activation: Activation,
    /// Effect of swapping the two images.
    pub symmetry: Symmetry,
}

/// A convolution with bias and zero padding.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Convolution {
    /// Name of the layer. Its parameters are `NAME.weight`, `[kernel, kernel, inputs, outputs]`, and `NAME.bias`,
    /// `[outputs]`.
    pub name: String,
    /// Input channels.
    pub inputs: usize,
    /// Output channels.
    pub outputs: usize,
    /// Width and height of the kernel.
    pub kernel: usize,
    /// Stride.
    pub stride: usize,
    /// Zero padding on each side.
    pub padding: usize,
}

/// A fully connected layer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FullyConnected {
    /// Name of the layer. Its parameters are `NAME.weight`, `[inputs, outputs]`, and `NAME.bias`, `[outputs]`.
    pub name: String,
    /// Input features.
    pub inputs: usize,
    /// Output features.
    pub outputs: usize,
}

/// Combination of the first and the second feature map into one.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Combine {
    /// The network sees a single image.
    None,
    /// Channels of the first map, followed by those of the second.
    Stack,
    /// Second map minus first map.
    Difference,
    /// Channels of `redirect` of the first map, followed by the activated correlation. Channel `n i + j` of the correlation
    /// is the mean over the channels of the first map at each pixel times the second map displaced by `stride i - reach`
    /// rows and `stride j - reach` columns; zero outside, with `n = 2 reach / stride + 1`.
    Correlation {
        /// Convolution of the first map.
        redirect: Convolution,
        /// Largest displacement in pixels.
        reach: usize,
        /// Step between displacements in pixels.
        stride: usize,
    },
}

/// Conversion of a feature map to a vector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Flatten {
    /// Row by row, pixel by pixel, with the channels of a pixel together.
    ChannelsLast,
    /// Mean of each channel (global average pooling).
    MeanOfChannels,
}

/// Effect of swapping the two images on the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Symmetry {
    /// Swapping negates the output exactly: `v(a, b) = (g(a, b) - g(b, a)) / 2`, where `g` is the network without this
    /// property. Then `v(a, a) = 0`, and the closed loop has no bias at its goal. Suits targets that are negated too, as the
    /// twist `log(T^-1) = -log(T)` is. Beyond the paper.
    ///
    /// It is imposed on the network as a whole. The DEFINet-style trunks already negate the difference of the features,
    /// but the layers after it are not odd functions.
    Antisymmetric,
    /// No constraint: `v(a, b) = g(a, b)`, as in the paper.
    None,
}

impl Architecture {
    /// Returns the architecture of a network that compares two images.
    pub(super) fn of_pairs(trunk: Trunk, symmetry: Symmetry, scale: &Scale, outputs: usize) -> Self {
        let siamese = trunk.siamese_layers();
        // Without siamese layers the first convolution sees the stacked pair.
        let inputs = if siamese == 0 { 2 * COLORS } else { COLORS };
        let (each_image, encoded) = convolutions(&ENCODER[..siamese], inputs, scale);
        let (combine, inputs) = match trunk {
            Trunk::FlowNetS => (Combine::Stack, encoded),
            Trunk::Definet | Trunk::DefinetGap => (Combine::Difference, encoded),
            Trunk::FlowNetC => {
                let redirect = convolution(&REDIRECT, encoded, scale);
                let channels = redirect.outputs + DISPLACEMENTS;
                (Combine::Correlation { redirect, reach: STRIDE * REACH, stride: STRIDE }, channels)
            }
        };
        let (combined, _) = convolutions(&ENCODER[siamese..], inputs, scale);
        let single = Self::of_images(trunk, scale, outputs);
        Self { each_image, combine, combined, symmetry, ..single }
    }

    /// Returns the architecture of a network that sees a single image.
    pub(super) fn of_images(trunk: Trunk, scale: &Scale, outputs: usize) -> Self {
        let (combined, channels) = convolutions(&ENCODER, COLORS, scale);
        let (flatten, features) = match trunk {
            Trunk::FlowNetS | Trunk::FlowNetC => (Flatten::ChannelsLast, pixels(scale) * channels),
            Trunk::Definet | Trunk::DefinetGap => (Flatten::MeanOfChannels, channels),
        };
        let units = [features, scale.head, scale.head, outputs];
        let head = ["head.hidden1", "head.hidden2", "head.output"].into_iter().zip(units.windows(2));
        let head = head.map(|(name, units)| FullyConnected {
            name: name.to_owned(),
            inputs: units[0],
            outputs: units[1],
        });
        Self {
            trunk,
            each_image: Vec::new(),
            combine: Combine::None,
            combined,
            flatten,
            head: head.collect(),
            activation: Activation::LEAKY,
            symmetry: Symmetry::None,
        }
    }

    /// Returns the convolutions in the order of computation.
    pub(crate) fn convolutions(&self) -> impl Iterator<Item = &Convolution> {
        let redirect = match &self.combine {
            Combine::Correlation { redirect, .. } => Some(redirect),
            _ => None,
        };
        self.each_image.iter().chain(redirect).chain(&self.combined)
    }
}

/// Returns the pixels of the last feature map.
fn pixels(scale: &Scale) -> usize {
    let stride: usize = ENCODER.iter().map(|layer| layer.stride).product();
    scale.input.iter().map(|size| size.div_ceil(stride)).product()
}

/// Chains layers, the first of which sees `inputs` channels. Also returns the channels of the last one.
fn convolutions(layers: &[Layer], mut inputs: usize, scale: &Scale) -> (Vec<Convolution>, usize) {
    let mut chained = Vec::new();
    for layer in layers {
        let next = convolution(layer, inputs, scale);
        inputs = next.outputs;
        chained.push(next);
    }
    (chained, inputs)
}

fn convolution(layer: &Layer, inputs: usize, scale: &Scale) -> Convolution {
    let Layer { name, channels, kernel, stride } = *layer;
    let (name, outputs) = (format!("trunk.{name}"), scale.channels(channels));
    Convolution { name, inputs, outputs, kernel, stride, padding: kernel / 2 }
}
