//! Warm start: a run that starts from a trained model, its parent, and computes exactly the same function at first.
//!
//! The weights alone do not determine that function, since the parent's labels determined the standardization of the
//! output. The run therefore keeps the parent's standardization. The optimizer starts fresh.

use std::fmt;
use std::path::{Path, PathBuf};

use burn::tensor::Device;

use super::files::{MODEL, invalid};
use super::lineage::{Parent, Version};
use super::load::Checkpoint;
use super::model_info::ModelInfo;
use crate::error::{Error, Result};
use crate::network::task::Task;

/// A verified model to start a run from. It has the same task as the run.
#[derive(Debug)]
pub struct WarmStart {
    directory: PathBuf,
    version: Option<Version>,
}

impl fmt::Display for WarmStart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.version {
            Some(version) => f.write_str(&version.name),
            None => self.directory.display().fmt(f),
        }
    }
}

impl WarmStart {
    /// Opens the checkpoint in a folder, which came from a published version, if any. Fails if it is damaged or has a
    /// different task.
    pub fn open(directory: &Path, version: Option<Version>, task: &Task) -> Result<Self> {
        let start = Self { directory: directory.to_owned(), version };
        start.check(&ModelInfo::verified(directory)?, task)?;
        Ok(start)
    }

    /// Reads and verifies the checkpoint. Also returns its identity for the new model's lineage.
    pub(crate) fn load(&self, task: &Task, device: &Device) -> Result<(Checkpoint, Parent)> {
        let checkpoint = Checkpoint::load(&self.directory, device)?;
        self.check(&checkpoint.info, task)?;
        let weights_sha256 = checkpoint.info.weights_sha256.clone();
        Ok((checkpoint, Parent { weights_sha256, version: self.version.clone() }))
    }

    fn check(&self, info: &ModelInfo, task: &Task) -> Result<()> {
        if let Some([key, was, is]) = task.difference(&info.task) {
            return Err(Error::OtherTask { model: self.to_string(), key, was, is });
        }
        match (&info.task, &info.standardization) {
            (Task::Approach { .. }, None) => {
                Err(invalid(&self.directory.join(MODEL), &"the standardization of the output is missing"))
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::sync::atomic::{AtomicBool, Ordering};

    use datagen::Kind;
    use tempfile::TempDir;
    use world::LabelForm;

    use super::*;
    use crate::config::TrainConfig;
    use crate::config::tests::{phase, tiny};
    use crate::data::examples::Examples;
    use crate::data::examples::tests::squares;
    use crate::data::standardization::Standardization;
    use crate::data::targets::Targets;
    use crate::training::fit::tests::{digests, still};
    use crate::training::{Event, Run, RunSummary, fit};

    fn config(kind: Kind, learning_rate: f64) -> TrainConfig {
        let mut config = tiny(kind);
        config.phases[0].learning_rate = learning_rate;
        config
    }

    /// Runs a configuration on examples, from a parent if there is one.
    fn run(
        config: &TrainConfig,
        start: Option<&WarmStart>,
        examples: &Examples,
        report: &mut dyn FnMut(Event),
    ) -> (TempDir, RunSummary) {
        let directory = tempfile::tempdir().unwrap();
        let config = TrainConfig { parent: start.map(ToString::to_string), ..config.clone() };
        let (device, stop) = (Device::flex(), AtomicBool::new(false));
        let run = Run { warm_start: start, ..still(&config, directory.path(), &device, &stop) };
        let fitted = fit(&run, examples, report).unwrap();
        (directory, fitted)
    }

    /// Returns a model trained on 32 squares, with the folder of its run.
    fn parent(kind: Kind) -> (TempDir, RunSummary, WarmStart) {
        let config = tiny(kind);
        let task = config.task().unwrap();
        let (folder, fitted) = run(&config, None, &squares(&task, 32), &mut |_| ());
        let version = Version { name: "approach@3".to_owned(), manifest_sha256: "ab".repeat(32) };
        let start = WarmStart::open(&fitted.checkpoint, Some(version), &task).unwrap();
        (folder, fitted, start)
    }

    /// Learning rate too small to change the initial weights.
    const IDLE: f64 = 1e-300;

    #[test]
    fn it_starts_as_the_parents_function_to_the_bit() {
        for kind in [Kind::Approach, Kind::Avoidance] {
            let (_folder, before, start) = parent(kind);
            let idle = config(kind, IDLE);
            let task = idle.task().unwrap();
            let was = ModelInfo::read(&before.checkpoint).unwrap();
            // The metrics are equal on the same data. Other data have other labels.
            let (_same, fitted) = run(&idle, Some(&start), &squares(&task, 32), &mut |_| ());
            assert_eq!(fitted.best.validation, before.best.validation);
            let (_other, fitted) = run(&idle, Some(&start), &squares(&task, 20), &mut |_| ());
            let is = ModelInfo::read(&fitted.checkpoint).unwrap();
            assert_eq!(is.weights_sha256, was.weights_sha256);
            assert_eq!(is.standardization, was.standardization);
            let found = is.parent.unwrap();
            assert_eq!(found.weights_sha256, was.weights_sha256);
            assert_eq!(found.version.unwrap().name, "approach@3");
            let (_cold, fitted) = run(&idle, None, &squares(&task, 20), &mut |_| ());
            let cold = ModelInfo::read(&fitted.checkpoint).unwrap();
            assert_ne!(cold.weights_sha256, was.weights_sha256);
            assert_eq!(
                (cold.standardization == was.standardization, cold.parent),
                (kind == Kind::Avoidance, None)
            );
        }
    }

    #[test]
    fn a_warm_start_is_an_advantage() {
        let (_folder, before, start) = parent(Kind::Approach);
        let mut config = tiny(Kind::Approach);
        config.phases = vec![phase(1)];
        let examples = squares(&config.task().unwrap(), 32);
        let [(_, warm), (_, cold)] =
            [Some(&start), None].map(|start| run(&config, start, &examples, &mut |_| ()));
        assert!(warm.last.training_loss < 1.2 * before.last.training_loss, "{warm:?}");
        assert!(warm.last.training_loss < cold.last.training_loss, "{cold:?}");
    }

    #[test]
    fn another_camera_is_reported_and_the_same_is_not() {
        let (_folder, _, start) = parent(Kind::Approach);
        let config = config(Kind::Approach, 1e-3);
        for (fov, expected) in [(60.0, None), (75.0, Some(("horizontal_fov_deg", 60.0, 75.0)))] {
            let mut reported = None;
            let examples = squares(&config.task().unwrap(), 32).seen_at(fov);
            run(&config, Some(&start), &examples, &mut |event| {
                if let Event::WarmStart { parent, other_camera } = event {
                    reported = Some((parent.to_string(), other_camera));
                }
            });
            assert_eq!(reported, Some(("approach@3".to_owned(), expected)));
        }
    }

    #[test]
    fn a_stopped_run_resumes_without_the_parent() {
        let (folder, _, start) = parent(Kind::Approach);
        let config = config(Kind::Approach, 1e-3);
        let examples = squares(&config.task().unwrap(), 20);
        let (whole, _) = run(&config, Some(&start), &examples, &mut |_| ());
        let parts = tempfile::tempdir().unwrap();
        let config = TrainConfig { parent: Some("approach@3".to_owned()), ..config };
        let (device, stop) = (Device::flex(), AtomicBool::new(false));
        let begun = Run { warm_start: Some(&start), ..still(&config, parts.path(), &device, &stop) };
        let stopped = fit(&begun, &examples, &mut |event| {
            stop.fetch_or(matches!(event, Event::Step { step: [5, _], .. }), Ordering::Relaxed);
        });
        assert!(matches!(stopped, Err(Error::Interrupted { .. })));
        folder.close().unwrap();
        stop.store(false, Ordering::Relaxed);
        let resumed = Run { resume: true, ..still(&config, parts.path(), &device, &stop) };
        fit(&resumed, &examples, &mut |_| ()).unwrap();
        assert_eq!(digests(whole.path()), digests(parts.path()));
        // A run from another model, or from none, is a different run.
        for (parent, is) in [(None, "\"absent\""), (Some("approach@4".to_owned()), "\"approach@4\"")] {
            let other = TrainConfig { parent, ..config.clone() };
            let other = Run { config: &other, ..resumed };
            let error = fit(&other, &examples, &mut |_| ()).unwrap_err().to_string();
            assert!(error.contains(&format!("parent = \"approach@3\", but now it is {is}")), "{error}");
        }
    }

    #[test]
    fn unusable_parents_are_refused() {
        let (_folder, before, _) = parent(Kind::Approach);
        let refused = |change: fn(&mut TrainConfig)| {
            let mut config = tiny(Kind::Approach);
            change(&mut config);
            let task = config.task().unwrap();
            WarmStart::open(&before.checkpoint, None, &task).map(|_| ()).unwrap_err().to_string()
        };
        let width = refused(|config| config.network.width = 0.04);
        assert!(width.contains("network.width = 0.02") && width.contains("has 0.04"), "{width}");
        let label = refused(|config| config.network.label = Some(LabelForm::Difference));
        assert!(label.contains("network.label = \"twist\"") && label.contains("\"difference\""), "{label}");
        let kind = refused(|config| *config = tiny(Kind::Avoidance));
        assert!(kind.contains("kind = \"approach\"") && kind.contains("\"avoidance\""), "{kind}");

        let file = before.checkpoint.join("model.json");
        let text = fs::read_to_string(&file).unwrap();
        let mut info: serde_json::Value = serde_json::from_str(&text).unwrap();
        info["standardization"] = serde_json::Value::Null;
        fs::write(&file, info.to_string()).unwrap();
        assert!(refused(|_| ()).contains("standardization"));
        fs::write(&file, text).unwrap();
        let weights = before.checkpoint.join("weights.safetensors");
        let mut bytes = fs::read(&weights).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        fs::write(&weights, bytes).unwrap();
        assert!(refused(|_| ()).contains("weights.safetensors is damaged"));
    }

    #[test]
    fn labels_that_are_not_finite_are_refused_as_without_it() {
        let (_folder, before, _) = parent(Kind::Approach);
        let info = ModelInfo::read(&before.checkpoint).unwrap();
        let examples = squares(&info.task, 20).with_a_label_missing();
        let targets = |given: Option<Standardization>| {
            let targets = Targets::new(&info.task, &examples, &[0, 1, 2], given);
            targets.map(|_| ())
        };
        assert!(matches!(targets(None), Err(Error::LabelsNotFinite)));
        assert!(matches!(targets(info.standardization.clone()), Err(Error::LabelsNotFinite)));
    }
}
