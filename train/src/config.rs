//! What a file of `configs/train/` says. It is complete: nothing has a default.

use std::fmt::Debug;
use std::path::PathBuf;

use datagen::Kind;
use serde::{Deserialize, Serialize};
use toml::Value;
use world::LabelForm;

use crate::error::{Error, Result};
use crate::net::{ApproachConfig, AvoidConfig, Symmetry, TrunkKind};

/// One training run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Which network is trained.
    pub kind: Kind,
    /// Directories of the datasets. Which of their examples are learned from, each phase says.
    pub datasets: Vec<PathBuf>,
    /// Decides the initial weights, the validation split and the order of the examples.
    pub seed: u64,
    /// Share of each dataset that is held out. Every phase is validated on these parts of all datasets.
    pub validation: f64,
    /// Where a batch's images come from. Nothing but time, memory and disk space depends on it.
    pub images: ImageSource,
    /// Published weights of FlowNetS or FlowNetC to begin from (see [`pretrained`](crate::pretrained)); without it the
    /// initial weights are random.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pretrained: Option<PathBuf>,
    /// The trained model to begin from (see [`warm_start`](crate::warm_start)): a checkpoint's folder, or a version in a
    /// registry, which `NAME@sha256:DIGEST` names exactly. Who starts the run finds it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub parent: Option<String>,
    /// Steps between two checkpoints within an epoch. Nothing but the time lost to a crash depends on it.
    pub checkpoint_steps: usize,
    /// The network.
    pub network: NetworkConfig,
    /// How it is fitted.
    pub optimizer: OptimizerConfig,
    /// One after the other, each from where the one before ended.
    pub phases: Vec<PhaseConfig>,
}

/// Where the images of a batch come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ImageSource {
    /// They are decoded once, before the first step, into a file that is mapped into memory.
    Cache,
    /// They are read and decoded for every batch, while the one before is computed.
    Stream,
}

/// Architecture. The last two keys belong to `kind = "approach"` alone: there they are needed, elsewhere refused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Multiplies the channels of every layer; 1 is the published `FlowNetS`.
    pub width: f64,
    /// Width and height of the network's input in pixels. Larger images are averaged down to it.
    pub input: [usize; 2],
    /// Width of the two hidden fully connected layers (paper: 2048).
    pub head: usize,
    /// What sees the images.
    pub trunk: TrunkKind,
    /// What swapping the two images does to the output.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub symmetry: Option<Symmetry>,
    /// What the six numbers of the output mean.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<LabelForm>,
}

/// How a network is fitted: `AdamW` with a one-cycle learning rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OptimizerConfig {
    /// Examples a step.
    pub batch: usize,
    /// Decoupled weight decay a step, in units of the learning rate.
    pub weight_decay: f64,
    /// Gradients with a greater norm over all parameters are shortened to it.
    pub gradient_clip: f64,
}

/// A part of a run with its own choice of examples and its own cycle of the learning rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PhaseConfig {
    /// Epochs, at most.
    pub epochs: usize,
    /// Peak of the learning rate.
    pub learning_rate: f64,
    /// Share of the phase's steps before the peak.
    pub warmup: f64,
    /// Proportion in which an epoch takes examples of the datasets, in their order; 0 leaves one out. Without it an
    /// epoch takes every example of every dataset.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ratio: Option<Vec<u32>>,
    /// The phase ends when its lowest validation loss is so many epochs old. Without it the phase takes all its epochs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub patience: Option<usize>,
}

/// What is learned, and by which network: a configuration whose keys fit together.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Task {
    /// `CNN_approach`: from two images to a pose change.
    Approach {
        /// Meaning of the pose change.
        label: LabelForm,
        /// Architecture.
        network: ApproachConfig,
    },
    /// `CNN_avoid`: from one image to an avoidance map.
    Avoidance {
        /// Architecture.
        network: AvoidConfig,
    },
}

impl Task {
    /// Which network.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Approach { .. } => Kind::Approach,
            Self::Avoidance { .. } => Kind::Avoidance,
        }
    }

    /// Width and height of the input in pixels.
    pub fn input(&self) -> [usize; 2] {
        match self {
            Self::Approach { network, .. } => network.input,
            Self::Avoidance { network } => network.input,
        }
    }

    /// The first key of a configuration that makes another task of it, its value there and here.
    pub(crate) fn difference(&self, other: &Self) -> Option<[String; 3]> {
        let values = |task: &Self| Value::try_from(task).expect("it is made of numbers and names");
        let [key, was, is] = difference("", &values(other), &values(self))?;
        let key = if key == "label" { "network.label".to_owned() } else { key };
        Some([key, was, is])
    }

    pub(crate) fn validate(&self) -> Result<()> {
        match self {
            Self::Approach { network, .. } => Ok(network.validate()?),
            Self::Avoidance { network } => Ok(network.validate()?),
        }
    }
}

impl TrainConfig {
    /// What is learned. Refuses values that make no training; names the key.
    pub fn task(&self) -> Result<Task> {
        self.optimizer.validate()?;
        require("datasets", !self.datasets.is_empty(), &"[]", "at least one directory")?;
        let share = self.validation;
        require("validation", share > 0.0 && share <= 0.5, &share, "a share above 0 and at most 0.5")?;
        if let (Some(file), Some(_)) = (&self.pretrained, &self.parent) {
            let expected = "no such key, since a run with a `parent` begins from its weights";
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
                let symmetry = self.needed("symmetry", self.network.symmetry)?;
                let label = self.needed("label", self.network.label)?;
                Task::Approach { label, network: ApproachConfig { trunk, symmetry, width, input, head } }
            }
            Kind::Avoidance => {
                self.meaningless("symmetry", self.network.symmetry.is_some())?;
                self.meaningless("label", self.network.label.is_some())?;
                Task::Avoidance { network: AvoidConfig { trunk, width, input, head } }
            }
        };
        task.validate()?;
        Ok(task)
    }

    /// The first key that another configuration has different, its value there and here. Where the datasets lie does
    /// not count, what they are is decided by their digests; how often state is saved and where images come from change no
    /// result.
    pub(crate) fn difference(&self, other: &Self) -> Option<[String; 3]> {
        let values = |config: &Self| {
            let images = ImageSource::Cache;
            let config = Self { datasets: Vec::new(), checkpoint_steps: 1, images, ..config.clone() };
            Value::try_from(config).expect("it was read from TOML")
        };
        difference("", &values(other), &values(self))
    }

    fn needed<T>(&self, key: &'static str, value: Option<T>) -> Result<T> {
        value.ok_or(Error::KeyOfKind { key, problem: "missing, but needed", kind: self.kind })
    }

    fn meaningless(&self, key: &'static str, given: bool) -> Result<()> {
        let problem = "given, but without meaning";
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
        require("warmup", (0.0..1.0).contains(warmup), warmup, "a share from 0 to less than 1")?;
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

/// Key, first and second value of the first difference.
fn difference(key: &str, first: &Value, second: &Value) -> Option<[String; 3]> {
    if let (Value::Array(a), Value::Array(b)) = (first, second)
        && a.len() == b.len()
    {
        let mut items = a.iter().zip(b).enumerate();
        return items.find_map(|(index, (a, b))| difference(&format!("{key}.{index}"), a, b));
    }
    let (Value::Table(a), Value::Table(b)) = (first, second) else {
        return (first != second).then(|| [key.to_owned(), first.to_string(), second.to_string()]);
    };
    let absent = Value::String("absent".to_owned());
    a.keys().chain(b.keys()).find_map(|name| {
        let inner = if key.is_empty() { name.clone() } else { format!("{key}.{name}") };
        difference(&inner, a.get(name).unwrap_or(&absent), b.get(name).unwrap_or(&absent))
    })
}

fn require(key: &'static str, holds: bool, value: &dyn ToString, expected: &'static str) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::Config { key, value: value.to_string(), expected }) }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A run that takes less than a second.
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
                trunk: TrunkKind::FlowNetS,
                symmetry: approach.then_some(Symmetry::Antisymmetric),
                label: approach.then_some(LabelForm::Twist),
            },
            optimizer: OptimizerConfig { batch: 4, weight_decay: 0.01, gradient_clip: 1.0 },
            phases: vec![phase(4)],
        }
    }

    /// A phase of some epochs.
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
    fn what_is_wrong_is_named() {
        let named = |change: fn(&mut TrainConfig)| {
            let mut config = tiny(Kind::Approach);
            change(&mut config);
            config.task().unwrap_err().to_string()
        };
        assert!(named(|c| c.validation = 0.0).starts_with("validation = 0:"));
        let both = |c: &mut TrainConfig| (c.pretrained, c.parent) = (Some("f".into()), Some("a@1".into()));
        assert!(named(both).starts_with("pretrained = f: expected no such key"));
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
        assert!(named(|c| c.kind = Kind::Avoidance).starts_with("network.symmetry: given"));
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
        other.network.trunk = TrunkKind::Definet;
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
