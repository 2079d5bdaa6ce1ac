//! Trained networks in use: from images to pose changes and avoidance maps.

use std::path::{Path, PathBuf};

use burn::tensor::{Device, Tensor};
use datagen::Kind;
use image::RgbImage;
use world::avoidance::AvoidanceMap;
use world::config::CameraConfig;
use world::{LabelForm, PoseChange};

use super::files::{MODEL, invalid};
use super::load::Checkpoint;
use super::model_info::ModelInfo;
use crate::data::standardization::Standardization;
use crate::data::{camera, input};
use crate::error::{Error, Result};
use crate::network::Network;
use crate::network::images::Images;
use crate::network::task::Task;

/// `CNN_approach`, trained.
#[derive(Debug)]
pub struct ApproachModel {
    network: Network,
    label: LabelForm,
    standardization: Standardization,
    input: ModelInput,
}

impl ApproachModel {
    /// Reads a checkpoint.
    pub fn load(directory: &Path, device: &Device) -> Result<Self> {
        let (network, input) = ModelInput::load(directory, device, Kind::Approach)?;
        match (&input.info.task, &input.info.standardization) {
            (Task::Approach { label, .. }, Some(standardization)) => {
                Ok(Self { network, label: *label, standardization: standardization.clone(), input })
            }
            _ => Err(invalid(&directory.join(MODEL), &"the standardization of the output is missing")),
        }
    }

    /// Returns the change of the hand pose that turns the current image into the goal image, in meters and radians. Its form
    /// is [`label`](Self::label).
    pub fn pose_change(&self, current: &RgbImage, goal: &RgbImage) -> Result<PoseChange> {
        let images = Images { current: self.input.tensor(current)?, goal: Some(self.input.tensor(goal)?) };
        let output = self.network.forward(images).into_data();
        let mut values = output.iter::<f32>().map(f64::from);
        let standardized = std::array::from_fn(|_| values.next().unwrap_or(f64::NAN));
        Ok(PoseChange::from_array(self.standardization.restore(standardized)))
    }

    /// Returns the form of the pose change.
    pub fn label(&self) -> LabelForm {
        self.label
    }

    /// Returns the information of the checkpoint.
    pub fn info(&self) -> &ModelInfo {
        &self.input.info
    }

    /// Fails if a camera shows the scene differently than the camera of the training images.
    pub fn require_camera(&self, camera: &CameraConfig) -> Result<()> {
        self.input.require_camera(camera)
    }
}

/// `CNN_avoid`, trained.
#[derive(Debug)]
pub struct AvoidModel {
    network: Network,
    input: ModelInput,
}

impl AvoidModel {
    /// Reads a checkpoint.
    pub fn load(directory: &Path, device: &Device) -> Result<Self> {
        let (network, input) = ModelInput::load(directory, device, Kind::Avoidance)?;
        Ok(Self { network, input })
    }

    /// Returns the avoidance map of the current image. The output is clamped to 0..=1, the range of Eq. (1).
    pub fn avoidance_map(&self, current: &RgbImage) -> Result<AvoidanceMap> {
        let images = Images { current: self.input.tensor(current)?, goal: None };
        let output = self.network.forward(images).clamp(0.0, 1.0).into_data();
        Ok(AvoidanceMap { values: output.iter::<f32>().map(f64::from).collect() })
    }

    /// Returns the information of the checkpoint.
    pub fn info(&self) -> &ModelInfo {
        &self.input.info
    }

    /// Fails if a camera shows the scene differently than the camera of the training images.
    pub fn require_camera(&self, camera: &CameraConfig) -> Result<()> {
        self.input.require_camera(camera)
    }
}

/// Converts images to the input of a loaded network.
#[derive(Debug)]
struct ModelInput {
    directory: PathBuf,
    info: ModelInfo,
    device: Device,
}

impl ModelInput {
    /// Reads a checkpoint, which must be of the `expected` kind.
    fn load(directory: &Path, device: &Device, expected: Kind) -> Result<(Network, Self)> {
        let device = device.clone().inner();
        let Checkpoint { directory, info, network } = Checkpoint::load(directory, &device)?;
        let found = info.task.kind();
        if found != expected {
            return Err(Error::OtherKind { path: directory, found, expected });
        }
        Ok((network, Self { directory, info, device }))
    }

    fn tensor(&self, image: &RgbImage) -> Result<Tensor<4>> {
        let input = self.info.task.input();
        Ok(input::tensor(&[&input::downsample(image, input)?], input, &self.device))
    }

    fn require_camera(&self, camera: &CameraConfig) -> Result<()> {
        match camera::difference(&self.info.camera, camera) {
            None => Ok(()),
            Some((key, trained, found)) => {
                Err(Error::OtherCamera { path: self.directory.clone(), key, trained, found })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::sync::atomic::AtomicBool;

    use image::Rgb;
    use image::imageops::{FilterType, resize};
    use serde_json::json;
    use tempfile::TempDir;

    use super::*;
    use crate::config::tests::{phase, tiny};
    use crate::data::batch::Batch;
    use crate::data::examples::tests::squares;
    use crate::data::split::Split;
    use crate::data::targets::Targets;
    use crate::metrics::Metrics;
    use crate::training::fit;
    use crate::training::fit::tests::still;

    /// Returns a checkpoint after one epoch.
    fn trained(kind: Kind) -> (TempDir, PathBuf) {
        let directory = tempfile::tempdir().unwrap();
        let mut config = tiny(kind);
        config.phases = vec![phase(1)];
        let (device, stop) = (Device::flex(), AtomicBool::new(false));
        let run = still(&config, directory.path(), &device, &stop);
        let summary = fit(&run, &squares(&config.task().unwrap(), 16), &mut |_| ()).unwrap();
        (directory, summary.checkpoint)
    }

    fn stripes(period: u32) -> RgbImage {
        RgbImage::from_fn(32, 24, |x, y| {
            if (x / period).is_multiple_of(2) { Rgb([y as u8 * 10, 9, 9]) } else { Rgb([200; 3]) }
        })
    }

    #[test]
    fn the_approach_model_is_antisymmetric_and_takes_larger_images() {
        let (_directory, checkpoint) = trained(Kind::Approach);
        let model = ApproachModel::load(&checkpoint, &Device::flex()).unwrap();
        assert_eq!(model.label(), LabelForm::Twist);
        let (a, b) = (stripes(4), stripes(5));
        let there = model.pose_change(&a, &b).unwrap();
        assert_eq!(there.scaled(-1.0), model.pose_change(&b, &a).unwrap());
        assert_eq!(model.pose_change(&a, &a).unwrap(), PoseChange::zero());
        assert!(there.translation.norm() > 0.0);
        let large = [&a, &b].map(|image| resize(image, 96, 72, FilterType::Nearest));
        assert_eq!(model.pose_change(&large[0], &large[1]).unwrap(), there);
        assert!(model.pose_change(&RgbImage::new(40, 24), &b).is_err());
    }

    #[test]
    fn a_loaded_checkpoint_equals_the_saved_one() {
        let (directory, checkpoint) = trained(Kind::Approach);
        let device = Device::flex();
        let [best, last] =
            [checkpoint, directory.path().join("last")].map(|path| Checkpoint::load(&path, &device));
        let [best, last] = [best.unwrap(), last.unwrap()];
        assert_eq!(best.info, last.info);
        // The loaded network reproduces the metrics of the network in training.
        let task = tiny(Kind::Approach).task().unwrap();
        let examples = squares(&task, 16);
        let split = Split::new(7, 0.25, &examples.ranges());
        let targets = Targets::new(&task, &examples, &split.all_training(), None).unwrap();
        let images = Batch::load(&examples, &split.validation).unwrap().images(&device);
        let outputs: Vec<f32> = best.network.forward(images).into_data().iter().collect();
        let metrics = Metrics::new(&targets, &split.validation, &outputs);
        assert_eq!(metrics, best.info.epoch.unwrap().validation);
        assert_eq!(targets.standardization(), best.info.standardization.as_ref());
    }

    #[test]
    fn the_avoid_model_gives_values_from_0_to_1() {
        let (_directory, checkpoint) = trained(Kind::Avoidance);
        let model = AvoidModel::load(&checkpoint, &Device::flex()).unwrap();
        let map = model.avoidance_map(&stripes(3)).unwrap();
        assert_eq!(map.values.len(), 180);
        let images = Images { current: model.input.tensor(&stripes(3)).unwrap(), goal: None };
        let linear = model.network.forward(images).into_data();
        let clamped: Vec<_> = linear.iter::<f32>().map(|value| f64::from(value.clamp(0.0, 1.0))).collect();
        assert_eq!(map.values, clamped);
        let camera = model.info().camera.clone();
        let vga = CameraConfig { width: 640, height: 480, ..camera.clone() };
        model.require_camera(&vga).unwrap();
        let wide = CameraConfig { horizontal_fov_deg: 75.0, ..camera };
        let error = model.require_camera(&wide).unwrap_err().to_string();
        assert!(error.contains("horizontal_fov_deg = 60, but this camera has 75"), "{error}");
    }

    /// Values that would exhaust the memory, divide by zero or leave an axis without a scale.
    #[test]
    fn an_unbuildable_network_is_refused() {
        let (_directory, checkpoint) = trained(Kind::Approach);
        let path = checkpoint.join("model.json");
        let original: serde_json::Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        let corruptions = [
            ("/task/network/head", json!(1_u64 << 40), "network.head"),
            ("/task/network/width", json!(1e9), "network.width"),
            ("/task/network/input", json!([1_u64 << 40, 24]), "network.input"),
            ("/standardization/mean", json!([0.0]), "6 means"),
            ("/standardization/scale", json!([1.0, 1.0, 1.0, 1.0, 1.0, 0.0]), "above 0"),
        ];
        for (key, value, expected) in corruptions {
            let mut info = original.clone();
            *info.pointer_mut(key).unwrap() = value;
            fs::write(&path, info.to_string()).unwrap();
            let refusal = ApproachModel::load(&checkpoint, &Device::flex()).unwrap_err().to_string();
            assert!(refusal.contains("model.json") && refusal.contains(expected), "{refusal}");
        }
    }

    /// The digest of these weights is correct, so that their reader has to detect the problem.
    #[test]
    fn weights_with_wrong_sizes_are_refused() {
        let (_directory, checkpoint) = trained(Kind::Avoidance);
        let (weights, model) = (checkpoint.join("weights.safetensors"), checkpoint.join("model.json"));
        let mut info: serde_json::Value = serde_json::from_str(&fs::read_to_string(&model).unwrap()).unwrap();
        let file = |length: u64, header: &str| [&length.to_le_bytes()[..], header.as_bytes()].concat();
        let bias = |shape: &str, offsets: &str| {
            let header = format!(
                r#"{{"head.hidden1.bias":{{"dtype":"F32","shape":{shape},"data_offsets":{offsets}}}}}"#
            );
            file(header.len() as u64, &header)
        };
        let corruptions = [
            Vec::new(),
            file(u64::MAX, "{}"),
            file(100_000_001, "{}"),
            file(3, "{}"),
            bias("[4611686018427387904]", "[0,0]"),
            bias("[1099511627776]", "[0,4398046511104]"),
            bias("[1099511627776,0]", "[0,0]"),
            bias("[8]", "[32,0]"),
        ];
        for weights_bytes in corruptions {
            fs::write(&weights, &weights_bytes).unwrap();
            info["weights_sha256"] = datagen::digest::digest(&weights_bytes).into();
            fs::write(&model, info.to_string()).unwrap();
            let refusal = AvoidModel::load(&checkpoint, &Device::flex()).unwrap_err();
            assert!(matches!(refusal, Error::Checkpoint { .. }), "{refusal}");
            assert!(refusal.to_string().contains("weights.safetensors"), "{refusal}");
        }
    }

    #[test]
    fn a_foreign_or_damaged_checkpoint_is_named() {
        let (_directory, checkpoint) = trained(Kind::Avoidance);
        let load = || AvoidModel::load(&checkpoint, &Device::flex());
        let other = ApproachModel::load(&checkpoint, &Device::flex()).unwrap_err();
        assert!(matches!(other, Error::OtherKind { found: Kind::Avoidance, .. }), "{other}");

        let model = checkpoint.join("model.json");
        let text = fs::read_to_string(&model).unwrap();
        let change = |from: &str, to: &str| fs::write(&model, text.replacen(from, to, 1)).unwrap();
        change("\"width\": 0.02", "\"width\": 0.04");
        let error = load().unwrap_err().to_string();
        assert!(error.contains("weights.safetensors") && error.contains("trunk.conv1.weight"), "{error}");
        change("\"format\": 2", "\"format\": 1");
        assert!(load().unwrap_err().to_string().contains("format 1"));
        fs::write(&model, &text).unwrap();
        load().unwrap();

        let weights = checkpoint.join("weights.safetensors");
        let mut bytes = fs::read(&weights).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        fs::write(&weights, bytes).unwrap();
        assert!(matches!(load(), Err(Error::Digest { .. })));
        fs::remove_file(&weights).unwrap();
        assert!(load().unwrap_err().to_string().contains("weights.safetensors"));
        assert!(
            AvoidModel::load(Path::new("nowhere"), &Device::flex())
                .unwrap_err()
                .to_string()
                .contains("nowhere")
        );
    }
}
