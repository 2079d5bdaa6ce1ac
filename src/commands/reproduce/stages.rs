//! The stages of an experiment. A stage whose result exists is reused.

use super::config::{ExperimentConfig, SystemConfig};
use crate::cli::NoteArgs;
use crate::commands::dataset::Generated;
use crate::commands::model::{attach, publish};
use crate::commands::train::Trained;
use crate::commands::{dataset, eval, lookup, train};
use crate::device::Opened;
use crate::output::note;
use crate::stop::Stop;
use ::eval::SessionRecord;
use ::eval::results::system::System;
use ::report::page::Stage;
use ::train::config::TrainConfig;
use anyhow::{Context, Result};
use registry::{Attachment, Digest, Location, ModelVersion, Registry};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Instant;
use world::units::{to_deg, to_mm};

/// Datasets by name: folder and result.
type Datasets = BTreeMap<String, (PathBuf, Generated)>;
/// Networks by name: folder of the run and result.
type Networks = BTreeMap<String, (PathBuf, Trained)>;

/// Networks published in the registry of the experiment.
pub(crate) struct PublishedNetworks {
    registry: Registry,
    /// Versions by name of the network, with the folders into which they are pulled.
    versions: BTreeMap<String, (ModelVersion, PathBuf)>,
}

/// Runs the stages and keeps a list of those that are finished.
pub(crate) struct Stages<'a> {
    config: &'a ExperimentConfig,
    out: &'a Path,
    device: &'a Opened,
    stop: &'a Stop,
    finished: Vec<Stage>,
}

impl<'a> Stages<'a> {
    /// Prepares the stages of an experiment in the folder `out`.
    pub(crate) fn new(
        config: &'a ExperimentConfig,
        out: &'a Path,
        device: &'a Opened,
        stop: &'a Stop,
    ) -> Self {
        Self { config, out, device, stop, finished: Vec::new() }
    }

    /// Returns the finished stages in order.
    pub(crate) fn finish(self) -> Vec<Stage> {
        self.finished
    }

    /// Returns the folder of a stage. `inputs` is everything that determines its content.
    fn folder(&self, kind: &str, name: &str, inputs: &impl Serialize) -> Result<PathBuf> {
        let digest = Digest::of(&serde_json::to_vec(inputs)?).hex();
        let plain = name.to_lowercase().replace(|c: char| !c.is_ascii_alphanumeric(), "-");
        Ok(self.out.join(kind).join(format!("{plain}-{}", &digest[..8])))
    }

    /// Adds a finished stage. `seconds` is `None` if its result was reused.
    fn done(&mut self, name: String, seconds: Option<f64>, result: String) {
        if seconds.is_none() {
            note!("{name}: already finished; {result}");
        }
        self.finished.push(Stage { name, seconds, result });
    }

    /// Generates all datasets.
    pub(crate) fn generate_datasets(&mut self) -> Result<Datasets> {
        let mut datasets = Datasets::new();
        for (name, config) in &self.config.datasets {
            let folder = self.folder("datasets", name, config)?;
            let generated = dataset::generate(config, &folder, self.stop)?;
            let seconds = (generated.rows_made > 0).then_some(generated.seconds);
            let result = format!("{} rows, {} images", generated.rows, generated.images);
            self.done(format!("dataset {name}"), seconds, result);
            datasets.insert(name.clone(), (folder, generated));
        }
        Ok(datasets)
    }

    /// Trains all networks.
    pub(crate) fn train_networks(&mut self, datasets: &Datasets) -> Result<Networks> {
        let mut networks = Networks::new();
        for (name, config) in &self.config.training {
            networks.insert(name.clone(), self.train_network(name, config, datasets)?);
        }
        Ok(networks)
    }

    fn train_network(
        &mut self,
        name: &str,
        config: &TrainConfig,
        datasets: &Datasets,
    ) -> Result<(PathBuf, Trained)> {
        let used: Vec<_> = config.datasets.iter().filter_map(|name| datasets.get(name.to_str()?)).collect();
        let digests: Vec<_> = used.iter().map(|(_, generated)| &generated.digest).collect();
        let folder = self.folder("training", name, &(config, digests, &self.device.name))?;
        let result = folder.join(train::RESULT);
        let name = format!("training {name}");
        let (trained, seconds) = if result.exists() {
            let text = std::fs::read_to_string(&result)?;
            (serde_json::from_str::<Trained>(&text).with_context(|| result.display().to_string())?, None)
        } else {
            let datasets = used.iter().map(|(folder, _)| folder.clone()).collect();
            let config = TrainConfig { datasets, ..config.clone() };
            let resume = ::train::can_resume(&folder);
            let (config, out, device) = (&config, folder.as_path(), self.device);
            let job = train::Job { name: &name, config, out, device, warm_start: None, resume };
            let trained = train::fit(&job, self.stop)?;
            let seconds = trained.seconds;
            (trained, Some(seconds))
        };
        self.done(name, seconds, train::in_words(&trained.best.validation));
        Ok((folder, trained))
    }

    /// Publishes the networks in a registry of the experiment, and pulls them for use.
    pub(crate) fn publish_networks(&self, networks: &Networks) -> Result<PublishedNetworks> {
        let location = Location::from(self.out.join("registry").as_path());
        let registry = Registry::init(&location)?;
        let mut versions = BTreeMap::new();
        for (name, (_, trained)) in networks {
            let version = publish::publish(&registry, &trained.checkpoint, name, None)?.value().clone();
            let folder = lookup::checkpoint(&version.to_string(), &location)?;
            versions.insert(name.clone(), (version, folder));
        }
        Ok(PublishedNetworks { registry, versions })
    }

    /// Runs the servo sessions of all systems. The figures of a system are attached to its networks. A network that several
    /// systems use gets those of the first.
    pub(crate) fn run_sessions(
        &mut self,
        published: &PublishedNetworks,
    ) -> Result<Vec<(System, Vec<SessionRecord>)>> {
        let (mut measured, mut evaluated) = (Vec::new(), BTreeSet::new());
        for system in &self.config.systems {
            let (folder, sessions) = self.run_system(system, published)?;
            measured.push(sessions);
            for network in [&system.approach, &system.avoid] {
                if let Some((version, checkpoint)) = published.versions.get(network)
                    && evaluated.insert(network)
                {
                    let figures = Attachment::Evaluation(attach::evaluation_of(checkpoint, &folder)?);
                    attach::attach(&published.registry, version, &figures, &NoteArgs::default())?;
                }
            }
        }
        Ok(measured)
    }

    /// Runs the sessions of a system. Returns their folder and results.
    fn run_system(
        &mut self,
        system: &SystemConfig,
        published: &PublishedNetworks,
    ) -> Result<(PathBuf, (System, Vec<SessionRecord>))> {
        let checkpoint = |policy: &String| {
            published.versions.get(policy).map_or(policy.clone(), |(_, folder)| folder.display().to_string())
        };
        let mut config = self.config.evaluation.clone();
        config.policies.approach = checkpoint(&system.approach);
        config.policies.avoid = checkpoint(&system.avoid);
        let folder = self.folder("evaluation", &system.name, &(&config, &self.device.name))?;
        let name = format!("sessions {}", system.name);
        let (records, seconds) = if folder.join(eval::SESSIONS).exists() {
            (eval::read(&folder)?, None)
        } else {
            let started = Instant::now();
            let records = eval::evaluate(&name, &config, self.device, self.stop)?;
            eval::write(&folder, &config, &records)?;
            (records, Some(started.elapsed().as_secs_f64()))
        };
        let measured = System::of(&system.name, &records);
        let (position, orientation) =
            (to_mm(measured.accuracy.position_norm()), to_deg(measured.accuracy.orientation_norm()));
        self.done(name, seconds, format!("norms of means {position:.2} mm, {orientation:.2} degrees"));
        Ok((folder, (measured, records)))
    }
}
