//! `config.json`: the network of a checkpoint, described so that other programs can build and use it.

use std::fs;
use std::path::Path;

use serde::Serialize;
use world::LabelForm;
use world::config::CameraConfig;

use super::files::{invalid, write_json};
use super::model_info::ModelInfo;
use crate::error::{Result, at};
use crate::network::architecture::Architecture;
use crate::network::avoid::DIRECTIONS;
use crate::network::task::Task;

/// Name of the file.
const FILE: &str = "config.json";

/// Contents of `config.json`. Derived from `model.json`; flowservo itself never reads it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Description {
    /// Version of this file format.
    pub format: u32,
    /// Program that made the network.
    pub model_type: &'static str,
    /// Layers. Their parameters are in `weights.safetensors`.
    pub network: Architecture,
    /// Input of the network.
    pub input: Input,
    /// Output of the network.
    pub output: Output,
    /// Camera of the training images. Other resolutions are fine, other views are not.
    pub camera: CameraConfig,
}

/// The input images.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Input {
    /// Role of each image, in order.
    pub images: Vec<&'static str>,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Color channels, in order.
    pub channels: &'static str,
    /// Downsampling of larger images with the same aspect ratio.
    pub shrink: &'static str,
    /// `value = byte * scale + offset`.
    pub scale: f64,
    /// See `scale`.
    pub offset: f64,
}

/// The output values.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Output {
    /// Motion of the hand that turns the current image into the goal image: `value = output * scale + mean` for each axis.
    PoseChange {
        /// `twist`: an element of se(3) in the current hand frame. `difference`: differences of positions and Euler angles
        /// in the robot frame.
        label: LabelForm,
        /// Names of the axes.
        axes: Vec<&'static str>,
        /// Units of the axes.
        units: Vec<&'static str>,
        /// Mean in these units.
        mean: Vec<f64>,
        /// Scale in these units.
        scale: Vec<f64>,
    },
    /// Risk of each direction: the output, clamped.
    AvoidanceMap {
        /// Number of directions.
        directions: usize,
        /// Smallest and largest value.
        clamp: [f64; 2],
    },
}

impl Description {
    /// Derives the description of a checkpoint. Returns `None` if the standardization of its output is missing.
    pub fn of(info: &ModelInfo) -> Option<Self> {
        let (images, output) = match &info.task {
            Task::Approach { label, .. } => {
                let standardization = info.standardization.clone()?;
                let output = Output::PoseChange {
                    label: *label,
                    axes: vec!["x", "y", "z", "phi", "theta", "psi"],
                    units: vec!["m", "m", "m", "rad", "rad", "rad"],
                    mean: standardization.mean,
                    scale: standardization.scale,
                };
                (vec!["current", "goal"], output)
            }
            Task::Avoidance { .. } => {
                let output = Output::AvoidanceMap { directions: DIRECTIONS, clamp: [0.0, 1.0] };
                (vec!["current"], output)
            }
        };
        let [width, height] = info.task.input();
        let (channels, shrink) = ("RGB", "mean over areas, rounded to whole bytes, half of one up");
        let input = Input { images, width, height, channels, shrink, scale: 2.0 / 255.0, offset: -1.0 };
        let (network, camera) = (info.task.architecture(), info.camera.clone());
        Some(Self { format: 1, model_type: "flowservo", network, input, output, camera })
    }

    /// Returns the description of a checkpoint and writes the file if it is missing, as in older checkpoints. Fails if the
    /// existing file contradicts `model.json`.
    pub fn complete(directory: &Path) -> Result<Self> {
        let info = ModelInfo::read(directory)?;
        let path = directory.join(FILE);
        let refuse = |problem: &str| invalid(&path, &problem);
        let description = Self::of(&info).ok_or_else(|| refuse("model.json lacks the standardization"))?;
        if !path.exists() {
            write_json(&path, &description)?;
            return Ok(description);
        }
        let text = fs::read_to_string(&path).map_err(at(&path))?;
        let found: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
        if serde_json::to_value(&description).is_ok_and(|expected| expected == found) {
            return Ok(description);
        }
        Err(refuse("it does not describe the network of model.json; remove it, and it will be written again"))
    }
}

#[cfg(test)]
mod tests {
    use datagen::Kind;

    use super::*;
    use crate::config::tests::tiny;
    use crate::data::standardization::Standardization;

    fn info(kind: Kind) -> ModelInfo {
        let camera = CameraConfig { width: 64, height: 48, horizontal_fov_deg: 60.0, behind_hand_mm: 100.0 };
        ModelInfo {
            format: 2,
            task: tiny(kind).task().unwrap(),
            standardization: (kind == Kind::Approach).then(|| Standardization {
                mean: vec![0.0; 6],
                scale: vec![0.1, 1.0 / 3.0, 0.3, 0.4, 0.5, 0.6],
            }),
            camera,
            datasets: Vec::new(),
            seed: 1,
            pretrained_sha256: None,
            parent: None,
            device: None,
            program: None,
            epoch: None,
            weights_sha256: String::new(),
        }
    }

    #[test]
    fn describes_everything_another_program_needs() {
        let json = serde_json::to_value(Description::of(&info(Kind::Approach)).unwrap()).unwrap();
        assert_eq!((&json["input"]["width"], &json["input"]["height"]), (&32.into(), &24.into()));
        assert_eq!((&json["output"]["label"], &json["output"]["units"][3]), (&"twist".into(), &"rad".into()));
        assert_eq!(json["output"]["scale"][1], 1.0 / 3.0);
        assert_eq!(
            (&json["network"]["symmetry"], &json["network"]["trunk"]),
            (&"antisymmetric".into(), &"flownet_s".into())
        );
        assert_eq!(json["network"]["combined"][0]["inputs"], 6);
        let avoid = serde_json::to_value(Description::of(&info(Kind::Avoidance)).unwrap()).unwrap();
        assert_eq!(
            (&avoid["output"]["kind"], &avoid["output"]["directions"]),
            (&"avoidance_map".into(), &180.into())
        );
        assert_eq!(avoid["network"]["combine"]["kind"], "none");
        assert_eq!(Description::of(&ModelInfo { standardization: None, ..info(Kind::Approach) }), None);
    }

    #[test]
    fn completes_a_checkpoint_once_and_refuses_a_contradiction() {
        let folder = tempfile::tempdir().unwrap();
        write_json(&folder.path().join("model.json"), &info(Kind::Approach)).unwrap();
        let written = Description::complete(folder.path()).unwrap();
        assert_eq!(Description::complete(folder.path()).unwrap(), written);
        let path = folder.path().join(FILE);
        let text = fs::read_to_string(&path).unwrap();
        fs::write(&path, text.replace("\"slope\": 0.1", "\"slope\": 0.2")).unwrap();
        let error = Description::complete(folder.path()).unwrap_err().to_string();
        assert!(error.contains("config.json") && error.contains("remove it"), "{error}");
    }
}
