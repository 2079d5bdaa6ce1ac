//! Learning tasks: pose changes and avoidance maps.

use datagen::Kind;
use serde::{Deserialize, Serialize};
use toml::Value;
use world::LabelForm;

use super::approach::ApproachConfig;
use super::architecture::Architecture;
use super::avoid::AvoidConfig;
use crate::difference::difference;
use crate::error::InvalidNetwork;

/// A learning task: the label and the network that predicts it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Task {
    /// `CNN_approach`: from two images to a pose change.
    Approach {
        /// Form of the pose change.
        label: LabelForm,
        /// Configuration of the network.
        network: ApproachConfig,
    },
    /// `CNN_avoid`: from one image to an avoidance map.
    Avoidance {
        /// Configuration of the network.
        network: AvoidConfig,
    },
}

impl Task {
    /// Returns the kind of data the task needs.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Approach { .. } => Kind::Approach,
            Self::Avoidance { .. } => Kind::Avoidance,
        }
    }

    /// Returns width and height of the network's input in pixels.
    pub fn input(&self) -> [usize; 2] {
        match self {
            Self::Approach { network, .. } => network.input,
            Self::Avoidance { network } => network.input,
        }
    }

    /// Returns the layers of the network.
    pub fn architecture(&self) -> Architecture {
        match self {
            Self::Approach { network, .. } => network.architecture(),
            Self::Avoidance { network } => network.architecture(),
        }
    }

    /// Checks the configuration of the network.
    pub(crate) fn validate(&self) -> Result<(), InvalidNetwork> {
        match self {
            Self::Approach { network, .. } => network.validate(),
            Self::Avoidance { network } => network.validate(),
        }
    }

    /// Returns the first configuration key in which another task differs, with the other's value and its own.
    pub(crate) fn difference(&self, other: &Self) -> Option<[String; 3]> {
        let values = |task: &Self| Value::try_from(task).expect("numbers and names are always TOML");
        let [key, was, is] = difference(&values(other), &values(self))?;
        let key = if key == "label" { "network.label".to_owned() } else { key };
        Some([key, was, is])
    }
}
