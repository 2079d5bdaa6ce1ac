//! `config.json` of a checkpoint: what its weights are, said so that another program can build the network and use it.

use std::fs;
use std::path::Path;

use serde::Serialize;
use world::LabelForm;
use world::config::CameraConfig;

use crate::checkpoint::{ModelInfo, write_json};
use crate::config::Task;
use crate::error::{Error, Result};
use crate::net::{Blueprint, DIRECTIONS};
use crate::publish::at;

/// Name of the file.
pub const FILE: &str = "config.json";

/// What `config.json` says. Nothing in flowservo reads it back: it is derived from `model.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Description {
    /// Version of this form.
    pub format: u32,
    /// The program whose networks these are.
    pub model_type: &'static str,
    /// The layers; their parameters are in `weights.safetensors`.
    pub network: Blueprint,
    /// What goes in.
    pub input: Input,
    /// What comes out.
    pub output: Output,
    /// The camera whose images the network knows. Other resolutions are fine, other views are not.
    pub camera: CameraConfig,
}

/// The images that a network takes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Input {
    /// What they show, in their order.
    pub images: Vec<&'static str>,
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// Colors of a pixel, in their order.
    pub channels: &'static str,
    /// How larger images, of the same aspect, become this small.
    pub shrink: &'static str,
    /// `value = byte * scale + offset`.
    pub scale: f64,
    /// See `scale`.
    pub offset: f64,
}

/// The numbers that a network yields.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Output {
    /// How the hand has to move until the current image is the goal image: `value = output * scale + mean`, for each axis.
    PoseChange {
        /// `twist`: of the Lie algebra se(3), in the current hand frame. `difference`: of positions and Euler angles, in the
        /// robot's frame.
        label: LabelForm,
        /// Names of the numbers.
        axes: Vec<&'static str>,
        /// Their units.
        units: Vec<&'static str>,
        /// In these units.
        mean: Vec<f64>,
        /// In these units.
        scale: Vec<f64>,
    },
    /// For each direction how much it leads toward an obstacle: the output, clamped.
    AvoidanceMap {
        /// How many.
        directions: usize,
        /// Least and greatest value.
        clamp: [f64; 2],
    },
}

impl Description {
    /// Of the checkpoint that says this of itself; nothing if the standardization of its output is not known.
    pub fn of(info: &ModelInfo) -> Option<Self> {
        let (network, images, output) = match &info.task {
            Task::Approach { label, network } => {
                let standardization = info.standardization.clone()?;
                let output = Output::PoseChange {
                    label: *label,
                    axes: vec!["x", "y", "z", "phi", "theta", "psi"],
                    units: vec!["m", "m", "m", "rad", "rad", "rad"],
                    mean: standardization.mean,
                    scale: standardization.scale,
                };
                (network.blueprint(), vec!["current", "goal"], output)
            }
            Task::Avoidance { network } => {
                let output = Output::AvoidanceMap { directions: DIRECTIONS, clamp: [0.0, 1.0] };
                (network.blueprint(), vec!["current"], output)
            }
        };
        let [width, height] = info.task.input();
        let (channels, shrink) = ("RGB", "mean over areas, rounded to whole bytes, half of one up");
        let input = Input { images, width, height, channels, shrink, scale: 2.0 / 255.0, offset: -1.0 };
        Some(Self { format: 1, model_type: "flowservo", network, input, output, camera: info.camera.clone() })
    }

    /// The description of a checkpoint, which is written into its folder if it is not there, as in those of older versions.
    /// Refuses one that says something else than `model.json`.
    pub fn complete(directory: &Path) -> Result<Self> {
        let info = ModelInfo::read(directory)?;
        let path = directory.join(FILE);
        let refuse = |problem: &str| Error::Checkpoint { path: path.clone(), problem: problem.to_owned() };
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
        Err(refuse("it does not describe the network of model.json; remove it, and it is written anew"))
    }
}

#[cfg(test)]
mod tests {
    use datagen::Kind;

    use super::*;
    use crate::config::tests::tiny;
    use crate::normalization::Standardization;

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
    fn says_all_that_a_stranger_needs() {
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
    fn completes_a_checkpoint_once_and_refuses_a_lie() {
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
