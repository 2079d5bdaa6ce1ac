//! Configuration of a training run: a file of `configs/train/`. It is complete; no value has a default.

use std::fmt::Debug;
use std::path::PathBuf;

use datagen::Kind;
use serde::{Deserialize, Serialize};
use toml::Value;
use world::LabelForm;

use crate::difference::difference;
use crate::error::{Error, Result};
use crate::network::approach::ApproachConfig;
use crate::network::architecture::Symmetry;
use crate::network::avoid::AvoidConfig;
use crate::network::task::Task;
use crate::network::trunk::Trunk;

/// Configuration of a training run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Kind of the network.
    pub kind: Kind,
    /// Folders of the datasets. Each phase chooses among their examples.
    pub datasets: Vec<PathBuf>,
    /// Seed of the initial weights, the validation split and the order of the examples.
    pub seed: u64,
    /// Fraction of each dataset held out for validation. Every phase is validated on all of them.
    pub validation: f64,
    /// Source of the images of a batch. It affects time, memory and disk space, but no result.
    pub images: ImageSource,
    /// Published weights of FlowNetS or FlowNetC to start from (see [`Imported`](crate::checkpoint::Imported)). Without
    /// it the initial weights are random.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pretrained: Option<PathBuf>,
    /// Trained model to start from (see [`WarmStart`](crate::checkpoint::WarmStart)): a checkpoint folder, or a version in
    /// a registry, exactly as `NAME@sha256:DIGEST`. The caller resolves it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parent: Option<String>,
    /// Steps between checkpoints within an epoch. It bounds the work lost in a crash and affects no result.
    pub checkpoint_steps: usize,
    /// The network.
    pub network: NetworkConfig,
    /// The optimizer.
    pub optimizer: OptimizerConfig,
    /// Phases of the run. Each continues with the weights of the one before.
    pub phases: Vec<PhaseConfig>,
}

/// Source of the images of a batch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ImageSource {
    /// A memory-mapped file, into which all images are decoded once before the first step.
    Cache,
    /// The dataset. Each batch is read and decoded while the previous one is in use.
    Stream,
}

/// Configuration of the network. `symmetry` and `label` are required for `kind = "approach"` and rejected otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Factor for the channels of every convolution; 1 is the published FlowNetS.
    pub width: f64,
    /// Width and height of the network's input in pixels. Larger images are averaged down to it.
    pub input: [usize; 2],
    /// Units of each of the two hidden fully connected layers (paper: 2048).
    pub head: usize,
    /// Trunk.
    pub trunk: Trunk,
    /// Effect of swapping the two images on the output.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub symmetry: Option<Symmetry>,
    /// Form of the six numbers of the output.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<LabelForm>,
}

/// Configuration of the optimizer, `AdamW` with a one-cycle learning rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimizerConfig {
    /// Examples per step.
    pub batch: usize,
    /// Decoupled weight decay per step, in units of the learning rate.
    pub weight_decay: f64,
    /// Maximum norm of the gradient over all parameters. Longer gradients are scaled down to it.
    pub gradient_clip: f64,
}

/// A part of a run with its own choice of examples and its own learning-rate cycle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhaseConfig {
    /// Maximum number of epochs.
    pub epochs: usize,
    /// Peak of the learning rate.
    pub learning_rate: f64,
    /// Fraction of the phase's steps before the peak.
    pub warmup: f64,
    /// Ratio in which an epoch draws examples from the datasets, in their order; 0 omits a dataset. Without it an
    /// epoch takes every example of every dataset.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ratio: Option<Vec<u32>>,
    /// Stops the phase after this many epochs without improvement in validation loss. Without it the phase takes all its
    /// epochs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub patience: Option<usize>,
}

impl TrainConfig {
    /// Validates the configuration and returns its task. Errors name the key.
    pub fn task(&self) -> Result<Task> {
        self.optimizer.validate()?;
        require("datasets", !self.datasets.is_empty(), &"[]", "at least one folder")?;
        let share = self.validation;
        require("validation", share > 0.0 && share <= 0.5, &share, "a fraction above 0 and at most 0.5")?;
        if let (Some(file), Some(_)) = (&self.pretrained, &self.parent) {
            let expected = "this key to be absent, since a run with a `parent` starts from its weights";
            require("pretrained", false, &file.display(), expected)?;
        }
        let steps = self.checkpoint_steps;
        require("checkpoint_steps", steps > 0, &steps, "at least 1")?;
        require("phases", !self.phases.is_empty(), &"[]", "at least one phase")?;
        for (index, phase) in self.phases.iter().enumerate() {
            phase.validate(index, self.datasets.len())?;
        }
        let NetworkConfig { trunk, width, input, head, .. } = self.network;
        let task = match self.kind {
            Kind::Approach => {
                let symmetry = self.required("symmetry", self.network.symmetry)?;
                let label = self.required("label", self.network.label)?;
                Task::Approach { label, network: ApproachConfig { trunk, symmetry, width, input, head } }
            }
            Kind::Avoidance => {
                self.refused("symmetry", self.network.symmetry.is_some())?;
                self.refused("label", self.network.label.is_some())?;
                Task::Avoidance { network: AvoidConfig { trunk, width, input, head } }
            }
        };
        task.validate()?;
        Ok(task)
    }

    /// Returns the first key in which another configuration differs, with the other's value and its own.
    ///
    /// Keys that affect no result are ignored: the folders of the datasets, which are compared by digest elsewhere, the
    /// interval between checkpoints, and the source of the images.
    pub(crate) fn difference(&self, other: &Self) -> Option<[String; 3]> {
        let values = |config: &Self| {
            let images = ImageSource::Cache;
            let config = Self { datasets: Vec::new(), checkpoint_steps: 1, images, ..config.clone() };
            Value::try_from(config).expect("it was read from TOML")
        };
        difference(&values(other), &values(self))
    }

    fn required<T>(&self, key: &'static str, value: Option<T>) -> Result<T> {
        value.ok_or(Error::KeyOfKind { key, problem: "missing, but required", kind: self.kind })
    }

    fn refused(&self, key: &'static str, given: bool) -> Result<()> {
        let problem = "not supported";
        if given { Err(Error::KeyOfKind { key, problem, kind: self.kind }) } else { Ok(()) }
    }
}

impl OptimizerConfig {
    fn validate(&self) -> Result<()> {
        let Self { batch, weight_decay, gradient_clip } = *self;
        require("optimizer.batch", (1..=65_536).contains(&batch), &batch, "1 to 65536")?;
        require("optimizer.weight_decay", (0.0..=1.0).contains(&weight_decay), &weight_decay, "0 to 1")?;
        let clip = gradient_clip > 0.0 && gradient_clip.is_finite();
        require("optimizer.gradient_clip", clip, &gradient_clip, "a norm above 0")
    }
}

impl PhaseConfig {
    fn validate(&self, index: usize, datasets: usize) -> Result<()> {
        let Self { epochs, learning_rate, warmup, ratio, patience } = self;
        let require = |key, holds, value: &dyn Debug, expected| {
            let value = format!("{value:?}");
            if holds { Ok(()) } else { Err(Error::Phase { index, key, value, expected }) }
        };
        require("epochs", (1..=100_000).contains(epochs), epochs, "1 to 100000")?;
        let rate = *learning_rate > 0.0 && *learning_rate <= 1.0;
        require("learning_rate", rate, learning_rate, "more than 0 and at most 1")?;
        require("warmup", (0.0..1.0).contains(warmup), warmup, "a fraction from 0 to less than 1")?;
        if let Some(ratio) = ratio {
            require("ratio", ratio.len() == datasets, ratio, "as many numbers as there are datasets")?;
            require("ratio", ratio.iter().any(|&part| part > 0), ratio, "at least one number above 0")?;
        }
        if let Some(patience) = patience {
            require("patience", *patience > 0, patience, "at least 1 epoch")?;
        }
        Ok(())
    }
}

fn require(key: &'static str, holds: bool, value: &dyn ToString, expected: &'static str) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::Config { key, value: value.to_string(), expected }) }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Configuration of a run that takes less than a second.
    pub(crate) fn tiny(kind: Kind) -> TrainConfig {
        let approach = kind == Kind::Approach;
        TrainConfig {
            kind,
            datasets: vec!["a".into()],
            seed: 7,
            validation: 0.25,
            images: ImageSource::Cache,
            pretrained: None,
            parent: None,
            checkpoint_steps: 4,
            network: NetworkConfig {
                width: 0.02,
                input: [32, 24],
                head: 16,
                trunk: Trunk::FlowNetS,
                symmetry: approach.then_some(Symmetry::Antisymmetric),
                label: approach.then_some(LabelForm::Twist),
            },
            optimizer: OptimizerConfig { batch: 4, weight_decay: 0.01, gradient_clip: 1.0 },
            phases: vec![phase(4)],
        }
    }

    /// A phase of `epochs` epochs.
    pub(crate) fn phase(epochs: usize) -> PhaseConfig {
        PhaseConfig { epochs, learning_rate: 3e-3, warmup: 0.1, ratio: None, patience: None }
    }

    #[test]
    fn a_configuration_survives_its_text() {
        for kind in [Kind::Approach, Kind::Avoidance] {
            let mut config = tiny(kind);
            config.phases.push(PhaseConfig { ratio: Some(vec![1]), patience: Some(3), ..phase(2) });
            let text = toml::to_string(&config).unwrap();
            assert_eq!(toml::from_str::<TrainConfig>(&text).unwrap(), config);
            assert_eq!(config.task().unwrap().kind(), kind);
            let misspelt = format!("epoch = 3\n{text}");
            assert!(toml::from_str::<TrainConfig>(&misspelt).unwrap_err().to_string().contains("`epoch`"));
        }
    }

    #[test]
    fn errors_name_the_key() {
        let named = |change: fn(&mut TrainConfig)| {
            let mut config = tiny(Kind::Approach);
            change(&mut config);
            config.task().unwrap_err().to_string()
        };
        assert!(named(|c| c.validation = 0.0).starts_with("validation = 0:"));
        let both = |c: &mut TrainConfig| (c.pretrained, c.parent) = (Some("f".into()), Some("a@1".into()));
        assert!(named(both).starts_with("pretrained = f: expected this key to be absent"));
        assert!(named(|c| c.checkpoint_steps = 0).starts_with("checkpoint_steps = 0:"));
        assert!(named(|c| c.optimizer.batch = 0).starts_with("optimizer.batch = 0:"));
        assert!(named(|c| c.phases.clear()).starts_with("phases = []:"));
        assert!(named(|c| c.phases[0].learning_rate = f64::NAN).starts_with("phases.0.learning_rate = NaN:"));
        assert!(
            named(|c| c.phases.push(PhaseConfig { epochs: 0, ..phase(1) }))
                .starts_with("phases.1.epochs = 0:")
        );
        assert!(named(|c| c.phases[0].ratio = Some(vec![1, 1])).starts_with("phases.0.ratio = [1, 1]:"));
        assert!(named(|c| c.phases[0].ratio = Some(vec![0])).starts_with("phases.0.ratio = [0]:"));
        assert!(named(|c| c.phases[0].patience = Some(0)).starts_with("phases.0.patience = 0:"));
        assert!(named(|c| c.network.width = -1.0).starts_with("network.width = -1:"));
        assert!(named(|c| c.network.label = None).starts_with("network.label: missing"));
        assert!(named(|c| c.kind = Kind::Avoidance).starts_with("network.symmetry: not supported"));
    }

    #[test]
    fn a_difference_is_named() {
        let ours = tiny(Kind::Approach);
        let mut other = ours.clone();
        other.datasets = vec!["elsewhere".into()];
        other.checkpoint_steps += 1;
        other.images = ImageSource::Stream;
        assert_eq!(ours.difference(&other), None);
        other.phases[0].epochs = 5;
        assert_eq!(ours.difference(&other), Some(["phases.0.epochs", "5", "4"].map(str::to_owned)));
        other.optimizer.batch = 8;
        assert_eq!(ours.difference(&other), Some(["optimizer.batch", "8", "4"].map(str::to_owned)));
        other.network.trunk = Trunk::Definet;
        assert_eq!(ours.difference(&other).unwrap()[0], "network.trunk");
    }

    #[test]
    fn the_shipped_configurations_are_valid() {
        let directory = concat!(env!("CARGO_MANIFEST_DIR"), "/../configs/train");
        let mut found = 0;
        for file in std::fs::read_dir(directory).unwrap() {
            let path = file.unwrap().path();
            let text = std::fs::read_to_string(&path).unwrap();
            let config: TrainConfig = toml::from_str(&text).unwrap_or_else(|e| panic!("{path:?}: {e}"));
            config.task().unwrap_or_else(|e| panic!("{path:?}: {e}"));
            found += 1;
        }
        assert!(found >= 4);
    }
}
