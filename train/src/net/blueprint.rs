//! A network as a list of layers: all that another program needs to build it, for `config.json`.

use serde::Serialize;

use super::approach::{ApproachConfig, Symmetry};
use super::avoid::{AvoidConfig, DIRECTIONS};
use super::conv::SLOPE;
use super::correlation::{DISPLACEMENTS, REACH, STRIDE};
use super::trunk::{Layer, REDIRECTED, TrunkKind};
use super::{Scale, trunk};

/// The layers of a network in the order in which they are computed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Blueprint {
    /// What the trunk is called.
    pub trunk: TrunkKind,
    /// Convolutions that see each image alone.
    pub each_image: Vec<Convolution>,
    /// How two images, or what the convolutions made of them, become one feature map.
    pub combine: Combine,
    /// Convolutions after that.
    pub combined: Vec<Convolution>,
    /// How the last feature map becomes a vector.
    pub flatten: Flatten,
    /// Fully connected layers, `y = x W + b`.
    pub head: Vec<Linear>,
    /// What follows every layer but the last.
    pub activation: Activation,
    /// With `antisymmetric`, the layers are run twice, the second time with the images swapped, and the output is half the
    /// first result minus half the second.
    pub symmetry: Symmetry,
}

/// A convolution with bias, zero padding and [`Activation`].
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Convolution {
    /// Its parameters are `NAME.weight`, `[kernel, kernel, inputs, outputs]`, and `NAME.bias`, `[outputs]`.
    pub name: String,
    /// Channels in.
    pub inputs: usize,
    /// Channels out.
    pub outputs: usize,
    /// Pixels along a side.
    pub kernel: usize,
    /// Pixels from one patch to the next.
    pub stride: usize,
    /// Zeros around the image, pixels on each side.
    pub padding: usize,
}

/// A fully connected layer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Linear {
    /// Its parameters are `NAME.weight`, `[inputs, outputs]`, and `NAME.bias`, `[outputs]`.
    pub name: String,
    /// Numbers in.
    pub inputs: usize,
    /// Numbers out.
    pub outputs: usize,
}

/// How the first and the second feature map become one.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Combine {
    /// There is one image only.
    None,
    /// The channels of the first, then those of the second.
    Stack,
    /// The second minus the first.
    Difference,
    /// `redirect` of the first, then the activated correlation: in channel `n i + j`, the mean over the channels of the first at
    /// each place times the second `stride i - reach` rows and `stride j - reach` columns further, zero outside, with
    /// `n = 2 reach / stride + 1`.
    Correlation {
        /// Past the correlation.
        redirect: Convolution,
        /// Greatest displacement, places.
        reach: usize,
        /// From one displacement to the next, places.
        stride: usize,
    },
}

/// How a feature map becomes a vector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Flatten {
    /// Row by row, place by place, the channels of a place together.
    ChannelsLast,
    /// The mean of each channel.
    MeanOfChannels,
}

/// A function of single numbers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Activation {
    /// Its name.
    pub kind: &'static str,
    /// Factor of negative numbers.
    pub slope: f64,
}

impl ApproachConfig {
    /// The layers of this network.
    pub fn blueprint(&self) -> Blueprint {
        Blueprint { symmetry: self.symmetry, ..blueprint(self.trunk, &self.scale(), 2, 6) }
    }
}

impl AvoidConfig {
    /// The layers of this network.
    pub fn blueprint(&self) -> Blueprint {
        blueprint(self.trunk, &self.scale(), 1, DIRECTIONS)
    }
}

/// The layers of a network for so many images and numbers.
fn blueprint(trunk: TrunkKind, scale: &Scale, images: usize, outputs: usize) -> Blueprint {
    let shared = if images == 1 { 0 } else { trunk::shared(trunk) };
    let layers = trunk::named_layers();
    let (each_image, combined) = layers.split_at(shared);
    let seen = if shared == 0 { 3 * images } else { 3 };
    let (each_image, encoded) = convolutions(each_image, seen, scale);
    let (combine, channels) = match (images, trunk) {
        (1, _) => (Combine::None, encoded),
        (_, TrunkKind::FlowNetS) => (Combine::Stack, encoded),
        (_, TrunkKind::Definet | TrunkKind::DefinetGap) => (Combine::Difference, encoded),
        (_, TrunkKind::FlowNetC) => {
            let redirect = convolution("conv_redir", (REDIRECTED, 1, 1), encoded, scale);
            let channels = redirect.outputs + DISPLACEMENTS;
            (Combine::Correlation { redirect, reach: STRIDE * REACH, stride: STRIDE }, channels)
        }
    };
    let (combined, _) = convolutions(combined, channels, scale);
    let averaged = matches!(trunk, TrunkKind::Definet | TrunkKind::DefinetGap);
    let widths = [trunk.features(scale), scale.head, scale.head, outputs];
    let head = ["hidden1", "hidden2", "output"].iter().zip(widths.windows(2));
    Blueprint {
        trunk,
        each_image,
        combine,
        combined,
        flatten: if averaged { Flatten::MeanOfChannels } else { Flatten::ChannelsLast },
        head: head
            .map(|(name, width)| Linear { name: format!("head.{name}"), inputs: width[0], outputs: width[1] })
            .collect(),
        activation: Activation { kind: "leaky_relu", slope: SLOPE },
        symmetry: Symmetry::None,
    }
}

/// `layers` one after the other, the first of which sees `inputs` channels, and the channels of the last.
fn convolutions(layers: &[(&str, Layer)], mut inputs: usize, scale: &Scale) -> (Vec<Convolution>, usize) {
    let mut made = Vec::new();
    for &(name, layer) in layers {
        let next = convolution(name, layer, inputs, scale);
        inputs = next.outputs;
        made.push(next);
    }
    (made, inputs)
}

fn convolution(name: &str, (outputs, kernel, stride): Layer, inputs: usize, scale: &Scale) -> Convolution {
    let (name, outputs) = (format!("trunk.{name}"), scale.channels(outputs));
    Convolution { name, inputs, outputs, kernel, stride, padding: kernel / 2 }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use burn::module::Module;
    use burn::tensor::Device;
    use burn_store::ModuleSnapshot;

    use super::*;

    /// Names and shapes of the parameters that a blueprint promises.
    fn promised(blueprint: &Blueprint) -> BTreeMap<String, Vec<usize>> {
        let mut shapes = BTreeMap::new();
        let redirect = match &blueprint.combine {
            Combine::Correlation { redirect, .. } => Some(redirect),
            _ => None,
        };
        for c in blueprint.each_image.iter().chain(redirect).chain(&blueprint.combined) {
            shapes.insert(format!("{}.weight", c.name), vec![c.kernel, c.kernel, c.inputs, c.outputs]);
            shapes.insert(format!("{}.bias", c.name), vec![c.outputs]);
        }
        for l in &blueprint.head {
            shapes.insert(format!("{}.weight", l.name), vec![l.inputs, l.outputs]);
            shapes.insert(format!("{}.bias", l.name), vec![l.outputs]);
        }
        shapes
    }

    /// What the network really has.
    fn found(network: &impl Module) -> BTreeMap<String, Vec<usize>> {
        let snapshots = network.collect(None, None, true);
        snapshots.iter().map(|tensor| (tensor.name.clone(), tensor.shape.to_vec())).collect()
    }

    #[test]
    fn promises_the_parameters_that_the_networks_have() {
        let device = Device::flex();
        for trunk in [TrunkKind::FlowNetS, TrunkKind::FlowNetC, TrunkKind::Definet, TrunkKind::DefinetGap] {
            let (width, input, head) = (0.07, [130, 70], 5);
            let symmetry = Symmetry::Antisymmetric;
            let approach = ApproachConfig { trunk, symmetry, width, input, head };
            assert_eq!(promised(&approach.blueprint()), found(&approach.init(1, &device)), "{trunk:?}");
            assert_eq!(approach.blueprint().symmetry, symmetry);
            let avoid = AvoidConfig { trunk, width, input, head };
            if avoid.validate().is_ok() {
                assert_eq!(promised(&avoid.blueprint()), found(&avoid.init(1, &device)), "{trunk:?}");
            }
        }
    }
}
