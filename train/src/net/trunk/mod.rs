//! Trunks: from images to a vector of features. A new trunk is one file here and its name in [`TrunkKind`] and
//! [`Trunk`].

mod definet;
mod flownet_s;

use burn::module::Module;
use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

use self::definet::Definet;
use self::flownet_s::FlowNetS;
use super::Scale;
use super::init::Init;

/// Which trunk sees the image pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TrunkKind {
    /// The encoder of FlowNetS on the stacked pair.
    #[serde(rename = "flownet_s")]
    FlowNetS,
    /// DEFINet-style: shared encoder, difference of the features, convolutions, global pooling.
    #[serde(rename = "definet")]
    Definet,
}

/// A trunk with its parameters.
#[derive(Module, Debug)]
pub enum Trunk {
    /// See [`TrunkKind::FlowNetS`].
    FlowNetS(FlowNetS),
    /// See [`TrunkKind::Definet`].
    Definet(Definet),
}

impl Trunk {
    /// A trunk for pairs of color images.
    pub fn for_pairs(kind: TrunkKind, scale: &Scale, init: &mut Init) -> Self {
        match kind {
            TrunkKind::FlowNetS => Self::FlowNetS(FlowNetS::new(scale, 6, init)),
            TrunkKind::Definet => Self::Definet(Definet::new(scale, init)),
        }
    }

    /// The trunk for single color images.
    pub fn for_images(scale: &Scale, init: &mut Init) -> Self {
        Self::FlowNetS(FlowNetS::new(scale, 3, init))
    }

    /// How many features `forward` yields for images of the size in `scale`.
    pub fn features(&self, scale: &Scale) -> usize {
        match self {
            Self::FlowNetS(_) => FlowNetS::features(scale),
            Self::Definet(_) => Definet::features(scale),
        }
    }

    /// # Shapes
    /// - `images`: `[batch, height, width, channels]`, a pair stacked along the channels
    /// - result: `[batch, features]`
    pub fn forward(&self, images: Tensor<4>) -> Tensor<2> {
        match self {
            Self::FlowNetS(trunk) => trunk.forward(images),
            Self::Definet(trunk) => trunk.forward(images),
        }
    }
}
