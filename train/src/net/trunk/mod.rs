//! Trunks: from images to a vector of features. A new trunk is one file here and its name in [`TrunkKind`] and
//! [`Trunk`].

mod definet;
mod flownet_c;
mod flownet_s;

pub use self::flownet_c::FlowNetC;
pub use self::flownet_s::FlowNetS;

use burn::module::Module;
use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

pub(super) use self::flownet_c::REDIRECTED;
pub(super) use self::flownet_s::Layer;

use super::Scale;
use super::init::Init;
use super::stack::stacked;

/// By how much the six layers of stride 2 shrink an image.
const SHRINK: usize = 64;

/// Names of the layers that all trunks share, in their order.
const NAMES: [&str; 10] =
    ["conv1", "conv2", "conv3", "conv3_1", "conv4", "conv4_1", "conv5", "conv5_1", "conv6", "conv6_1"];

/// The layers that all trunks share, with their names.
pub(super) fn named_layers() -> [(&'static str, Layer); 10] {
    std::array::from_fn(|index| (NAMES[index], flownet_s::LAYERS[index]))
}

/// How many of the shared layers see each image of a pair alone.
pub(super) fn shared(kind: TrunkKind) -> usize {
    match kind {
        TrunkKind::FlowNetS => 0,
        TrunkKind::FlowNetC => flownet_c::SHARED,
        TrunkKind::Definet => definet::EARLY,
        TrunkKind::DefinetGap => definet::LATE,
    }
}

/// Which trunk sees the images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TrunkKind {
    /// The encoder of FlowNetS on the stacked pair.
    #[serde(rename = "flownet_s")]
    FlowNetS,
    /// The encoder of FlowNetC: shared layers, correlation of the features, the other layers of FlowNetS.
    #[serde(rename = "flownet_c")]
    FlowNetC,
    /// DEFINet-style: shared encoder, difference of the features, convolutions, global pooling.
    #[serde(rename = "definet")]
    Definet,
    /// DEFINet-style, with the global pooling straight after the difference.
    #[serde(rename = "definet_gap")]
    DefinetGap,
}

impl TrunkKind {
    /// How many features it yields for images of the size in `scale`.
    pub(super) fn features(self, scale: &Scale) -> usize {
        let channels = scale.channels(flownet_s::LAYERS[9].0);
        let [width, height] = scale.input.map(|size| size.div_ceil(SHRINK));
        match self {
            Self::FlowNetS | Self::FlowNetC => width * height * channels,
            Self::Definet | Self::DefinetGap => channels,
        }
    }
}

/// A trunk for pairs of color images. All but the first see each image alone before they compare.
#[derive(Module, Debug)]
pub enum Trunk {
    /// See [`TrunkKind::FlowNetS`].
    FlowNetS(FlowNetS),
    /// See [`TrunkKind::FlowNetC`].
    FlowNetC(FlowNetC),
    /// See [`TrunkKind::Definet`].
    Definet(FlowNetS),
    /// See [`TrunkKind::DefinetGap`].
    DefinetGap(FlowNetS),
}

impl Trunk {
    /// The untrained trunk.
    pub fn new(kind: TrunkKind, scale: &Scale, init: &mut Init) -> Self {
        match kind {
            TrunkKind::FlowNetS => Self::FlowNetS(FlowNetS::new(scale, 6, init)),
            TrunkKind::FlowNetC => Self::FlowNetC(FlowNetC::new(scale, init)),
            TrunkKind::Definet => Self::Definet(FlowNetS::new(scale, 3, init)),
            TrunkKind::DefinetGap => Self::DefinetGap(FlowNetS::new(scale, 3, init)),
        }
    }

    /// What the trunk makes of each image alone; the images themselves if it is nothing.
    ///
    /// # Shapes
    /// - `images`: `[batch, height, width, 3]`
    /// - result: `[batch, height, width, channels]` of a feature map
    pub fn encode(&self, images: Tensor<4>) -> Tensor<4> {
        match self {
            Self::FlowNetS(_) => images,
            Self::FlowNetC(trunk) => trunk.encode(images),
            Self::Definet(layers) => definet::encode(layers, definet::EARLY, images),
            Self::DefinetGap(layers) => definet::encode(layers, definet::LATE, images),
        }
    }

    /// What the trunk makes of two encoded images.
    ///
    /// # Shapes
    /// - `first`, `second`: as [`encode`](Self::encode) yields them
    /// - result: `[batch, features]`
    pub fn compare(&self, first: Tensor<4>, second: Tensor<4>) -> Tensor<2> {
        match self {
            Self::FlowNetS(trunk) => trunk.flattened(stacked(first, second)),
            Self::FlowNetC(trunk) => trunk.compare(first, second),
            Self::Definet(layers) => definet::compare(layers, definet::EARLY, [first, second]),
            Self::DefinetGap(layers) => definet::compare(layers, definet::LATE, [first, second]),
        }
    }
}

#[cfg(test)]
mod tests {
    use burn::module::Module;
    use burn::tensor::Device;

    use super::*;

    const KINDS: [TrunkKind; 4] =
        [TrunkKind::FlowNetS, TrunkKind::FlowNetC, TrunkKind::Definet, TrunkKind::DefinetGap];

    #[test]
    fn parameters_of_the_published_encoders() {
        let scale = Scale { width: 1.0, input: [640, 480], head: 2048 };
        let mut init = Init::new(0, &Device::flex());
        let mut parameters = |kind| Trunk::new(kind, &scale, &mut init).num_params();
        assert_eq!(parameters(TrunkKind::FlowNetS), 24_050_752);
        assert_eq!(parameters(TrunkKind::FlowNetC), 24_549_536);
        // conv1 sees 3 channels instead of 6.
        let single = 24_050_752 - 3 * 7 * 7 * 64;
        assert_eq!([TrunkKind::Definet, TrunkKind::DefinetGap].map(parameters), [single, single]);
        assert_eq!(KINDS.map(|kind| kind.features(&scale)), [8 * 10 * 1024, 8 * 10 * 1024, 1024, 1024]);
    }

    #[test]
    fn features_are_counted_as_they_come() {
        let device = Device::flex();
        for input in [[64, 48], [129, 65], [100, 70]] {
            let scale = Scale { width: 0.05, input, head: 8 };
            for kind in KINDS {
                let trunk = Trunk::new(kind, &scale, &mut Init::new(0, &device));
                let images = trunk.encode(Tensor::zeros([2, input[1], input[0], 3], &device));
                let features = trunk.compare(images.clone(), images);
                assert_eq!(features.dims(), [2, kind.features(&scale)], "{kind:?}");
            }
        }
    }
}
