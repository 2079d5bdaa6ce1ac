//! `flowservo reproduce`: every stage of the paper's experiment in one go.
//!
//! ```text
//! runs/quick/config.toml               what was run, complete
//! runs/quick/datasets/a-1f3c9a2b/      datasets
//! runs/quick/training/approach-.../    networks
//! runs/quick/registry/                 the trained networks, as published versions with Table 1's figures
//! runs/quick/evaluation/plain-.../     servo sessions, step by step
//! runs/quick/table1.{txt,md,csv,json}  Table 1
//! runs/quick/results.json              what every stage says with --json
//! runs/quick/report.html               everything on one page
//! ```
//!
//! The digits in a stage's folder are the digest of all that decides its content, so a finished stage is used again exactly
//! as long as nothing in front of it has changed.

use super::dataset::Generated;
use super::train::Trained;
use super::{dataset, eval, model, model_attach, model_publish, print_json, report, train, write_file};
use crate::cli::{self, NoteArgs};
use crate::config::{Config, bad_input};
use crate::device::{self, Opened};
use crate::output::{note, out};
use crate::stop::Stop;
use ::eval::config::EvalConfig;
use ::eval::measures::{self, System};
use ::eval::report::Stage;
use ::eval::tables;
use ::eval::trace::SessionRecord;
use ::train::config::TrainConfig;
use anyhow::{Context, Result, anyhow};
use datagen::DatasetConfig;
use registry::{Attachment, Digest, Location, ModelVersion, Registry};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What a file in `configs/reproduce/` says.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ReproduceConfig {
    /// Datasets by name.
    pub(crate) datasets: BTreeMap<String, DatasetConfig>,
    /// Networks by name; their `datasets` are names from above.
    pub(crate) training: BTreeMap<String, TrainConfig>,
    /// The servo sessions; their policies are replaced by each system's.
    pub(crate) evaluation: EvalConfig,
    /// The rows of Table 1; the first is the one that the figures show.
    pub(crate) systems: Vec<SystemConfig>,
}

/// A row of Table 1: the two networks of a system.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SystemConfig {
    /// Name in the tables.
    pub(crate) name: String,
    /// A name from `training`, or `oracle`.
    pub(crate) approach: String,
    /// A name from `training`, or `oracle`.
    pub(crate) avoid: String,
}

/// Everything that the stages made.
pub(crate) struct Reproduced {
    /// What was run.
    pub(crate) config: ReproduceConfig,
    /// Where it was computed.
    pub(crate) device: String,
    /// Stages in their order.
    pub(crate) stages: Vec<Stage>,
    /// Datasets in their order.
    pub(crate) datasets: Vec<Generated>,
    /// Networks by name: folder of the run, and how it went.
    pub(crate) trained: BTreeMap<String, (PathBuf, Trained)>,
    /// Systems in their order, with their sessions.
    pub(crate) systems: Vec<(System, Vec<SessionRecord>)>,
}

/// Runs the command.
pub(crate) fn run(arguments: &cli::Reproduce, stop: &Stop, json: bool) -> Result<()> {
    let started = Instant::now();
    let preset = arguments.preset.name();
    let path = arguments.configs.join("reproduce").join(format!("{preset}.toml"));
    if !path.exists() {
        let place = arguments.configs.display();
        return Err(bad_input(anyhow!(
            "{} does not exist; run in the repository's folder, or name its configurations with --configs (now {place})",
            path.display()
        )));
    }
    let file = Config::load(&path, &arguments.overrides)?;
    let config: ReproduceConfig = file.parse()?;
    config.check(&file)?;
    let out = arguments.out.clone().unwrap_or_else(|| Path::new("runs").join(preset));
    write_file(&out.join("config.toml"), toml::to_string(&config)?)?;
    let device = device::open(arguments.device)?;
    note!("reproduce: preset {preset}, into {}, on {}", out.display(), device.name);

    let mut reproduction = Reproduction { config, out, device, stop, stages: Vec::new() };
    let reproduced = reproduction.all_stages().map_err(|error| {
        if stop.is_raised() { error.context("stopped; the same command goes on where it was") } else { error }
    })?;
    let Reproduction { out, device: Opened { device, .. }, .. } = reproduction;
    let systems: Vec<System> = reproduced.systems.iter().map(|(system, _)| system.clone()).collect();
    eval::write_tables(&out, &systems)?;
    let results = results(&reproduced, started.elapsed().as_secs_f64());
    write_file(&out.join("results.json"), serde_json::to_string_pretty(&results)?)?;
    report::write(preset, &reproduced, &device, &out)?;
    out!("{}", tables::to_text(&systems));
    out!("report: {}", out.join("report.html").display());
    note!("reproduce: done in {:.0} s", started.elapsed().as_secs_f64());
    print_json(json, &results)
}

fn results(reproduced: &Reproduced, seconds: f64) -> serde_json::Value {
    let trained: BTreeMap<_, _> =
        reproduced.trained.iter().map(|(name, (_, trained))| (name, trained)).collect();
    let systems: Vec<_> = reproduced.systems.iter().map(|(system, _)| measures::to_json(system)).collect();
    serde_json::json!({
        "seconds": seconds,
        "device": reproduced.device,
        "datasets": reproduced.datasets,
        "training": trained,
        "evaluation": systems,
    })
}

impl ReproduceConfig {
    /// Refuses what cannot come to its end, before any work is done.
    fn check(&self, file: &Config) -> Result<()> {
        for (name, dataset) in &self.datasets {
            file.check(dataset.validate()).with_context(|| format!("datasets.{name}"))?;
        }
        for (name, training) in &self.training {
            file.check(training.task()).with_context(|| format!("training.{name}"))?;
            if let Some(parent) = &training.parent {
                return Err(bad_input(anyhow!(
                    "training.{name}.parent = {parent:?}: expected no such key, since all that `reproduce` needs it makes \
                     itself; `flowservo train` begins from a model"
                )));
            }
            for dataset in &training.datasets {
                let known = dataset.to_str().is_some_and(|dataset| self.datasets.contains_key(dataset));
                let unknown =
                    || format!("training.{name}.datasets: there is no datasets.{}", dataset.display());
                known.then_some(()).with_context(unknown).map_err(bad_input)?;
            }
        }
        file.check(self.evaluation.validate()).context("evaluation")?;
        for system in &self.systems {
            for policy in [&system.approach, &system.avoid] {
                let known = policy == eval::ORACLE || self.training.contains_key(policy);
                let unknown = || format!("system {}: there is no training.{policy}", system.name);
                known.then_some(()).with_context(unknown).map_err(bad_input)?;
            }
        }
        (!self.systems.is_empty()).then_some(()).context("systems: at least one is needed").map_err(bad_input)
    }
}

/// A run of all stages under way.
struct Reproduction<'a> {
    config: ReproduceConfig,
    out: PathBuf,
    device: Opened,
    stop: &'a Stop,
    stages: Vec<Stage>,
}

impl Reproduction<'_> {
    fn all_stages(&mut self) -> Result<Reproduced> {
        let ReproduceConfig { datasets, training, systems, .. } = self.config.clone();
        let mut folders = BTreeMap::new();
        let mut made = Vec::new();
        for (name, config) in &datasets {
            let (folder, generated) = self.dataset(name, config)?;
            folders.insert(name.clone(), (folder, generated.digest.clone()));
            made.push(generated);
        }
        let mut trained = BTreeMap::new();
        for (name, config) in &training {
            trained.insert(name.clone(), self.network(name, config, &folders)?);
        }
        let location = Location::from(self.out.join("registry").as_path());
        let registry = Registry::init(&location)?;
        let published = publish(&registry, &location, &trained)?;
        let (mut evaluated, mut judged) = (Vec::new(), BTreeSet::new());
        for system in &systems {
            let (folder, measured) = self.system(system, &published)?;
            evaluated.push(measured);
            // What several systems share is judged by the first of them.
            for network in [&system.approach, &system.avoid] {
                if let Some((version, checkpoint)) = published.get(network)
                    && judged.insert(network)
                {
                    let figures = Attachment::Evaluation(model_attach::evaluation_of(checkpoint, &folder)?);
                    model_attach::attach(&registry, version, &figures, &NoteArgs::default())?;
                }
            }
        }
        Ok(Reproduced {
            config: self.config.clone(),
            device: self.device.name.clone(),
            stages: std::mem::take(&mut self.stages),
            datasets: made,
            trained,
            systems: evaluated,
        })
    }

    /// Folder of a stage whose content `decided_by` decides.
    fn folder(&self, kind: &str, name: &str, decided_by: &impl Serialize) -> Result<PathBuf> {
        let digest = Digest::of(&serde_json::to_vec(decided_by)?).hex();
        let plain = name.to_lowercase().replace(|c: char| !c.is_ascii_alphanumeric(), "-");
        Ok(self.out.join(kind).join(format!("{plain}-{}", &digest[..8])))
    }

    fn done(&mut self, name: String, seconds: Option<f64>, result: String) {
        if seconds.is_none() {
            note!("{name}: finished before; {result}");
        }
        self.stages.push(Stage { name, seconds, result });
    }

    fn dataset(&mut self, name: &str, config: &DatasetConfig) -> Result<(PathBuf, Generated)> {
        let folder = self.folder("datasets", name, config)?;
        let generated = dataset::generate(config, &folder, self.stop)?;
        let seconds = (generated.rows_made > 0).then_some(generated.seconds);
        self.done(
            format!("dataset {name}"),
            seconds,
            format!("{} rows, {} images", generated.rows, generated.images),
        );
        Ok((folder, generated))
    }

    fn network(
        &mut self,
        name: &str,
        config: &TrainConfig,
        datasets: &BTreeMap<String, (PathBuf, String)>,
    ) -> Result<(PathBuf, Trained)> {
        let used: Vec<_> = config.datasets.iter().filter_map(|name| datasets.get(name.to_str()?)).collect();
        let digests: Vec<_> = used.iter().map(|(_, digest)| digest).collect();
        let folder = self.folder("training", name, &(config, digests, &self.device.name))?;
        let result = folder.join(train::RESULT);
        let (trained, seconds) = if result.exists() {
            let text = std::fs::read_to_string(&result)?;
            (serde_json::from_str::<Trained>(&text).with_context(|| result.display().to_string())?, None)
        } else {
            let config = TrainConfig {
                datasets: used.iter().map(|(folder, _)| folder.clone()).collect(),
                ..config.clone()
            };
            let resume = ::train::fit::can_resume(&folder);
            let name = format!("training {name}");
            let device = &self.device;
            let (config, out) = (&config, folder.as_path());
            let job = train::Job { name: &name, config, out, device, warm_start: None, resume };
            let trained = train::fit(&job, self.stop)?;
            let seconds = trained.seconds;
            (trained, Some(seconds))
        };
        self.done(format!("training {name}"), seconds, train::in_words(&trained.best.validation));
        Ok((folder, trained))
    }

    /// The servo sessions of a system, and the folder in which they lie.
    fn system(
        &mut self,
        system: &SystemConfig,
        published: &BTreeMap<String, (ModelVersion, PathBuf)>,
    ) -> Result<(PathBuf, (System, Vec<SessionRecord>))> {
        let place = |policy: &String| {
            published.get(policy).map_or(policy.clone(), |(_, folder)| folder.display().to_string())
        };
        let mut config = self.config.evaluation.clone();
        config.policies.approach = place(&system.approach);
        config.policies.avoid = place(&system.avoid);
        let folder = self.folder("evaluation", &system.name, &(&config, &self.device.name))?;
        let (records, seconds) = if folder.join(eval::SESSIONS).exists() {
            (eval::read(&folder)?, None)
        } else {
            let started = Instant::now();
            let records =
                eval::evaluate(&format!("sessions {}", system.name), &config, &self.device, self.stop)?;
            eval::write(&folder, &config, &records)?;
            (records, Some(started.elapsed().as_secs_f64()))
        };
        let measured = System::of(&system.name, &records);
        let accuracy = &measured.accuracy;
        let result = format!(
            "norms of means {:.2} mm, {:.2} degrees",
            world::units::to_mm(accuracy.position_norm()),
            world::units::to_deg(accuracy.orientation_norm())
        );
        self.done(format!("sessions {}", system.name), seconds, result);
        Ok((folder, (measured, records)))
    }
}

/// Publishes the networks into the run's own registry; the versions, and the folders from which they are used, by name.
fn publish(
    registry: &Registry,
    location: &Location,
    trained: &BTreeMap<String, (PathBuf, Trained)>,
) -> Result<BTreeMap<String, (ModelVersion, PathBuf)>> {
    let mut published = BTreeMap::new();
    for (name, (_, trained)) in trained {
        let version = model_publish::publish(registry, &trained.checkpoint, name, None)?.value().clone();
        let folder = model::checkpoint(&version.to_string(), location)?;
        published.insert(name.clone(), (version, folder));
    }
    Ok(published)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shipped_presets_can_come_to_their_end() {
        for preset in ["quick", "cpu", "paper"] {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("configs/reproduce/{preset}.toml"));
            let file = Config::load(&path, &[]).unwrap();
            let config: ReproduceConfig = file.parse().unwrap();
            config.check(&file).unwrap();
            let mut begun = config.clone();
            begun.training.values_mut().for_each(|training| training.parent = Some("approach@1".to_owned()));
            let refused = begun.check(&file).unwrap_err().to_string();
            assert!(refused.contains("parent = \"approach@1\""), "{refused}");
            // What the paper calls 52,000 examples, in its ratio.
            let counts = ["a", "b", "c"].map(|name| config.datasets[name].count);
            assert_eq!(counts, [20_000, 20_000, 12_000], "{preset}");
            // Networks are evaluated with the camera whose images they know.
            assert!(
                config.datasets.values().all(|dataset| dataset.world == config.evaluation.world),
                "{preset}"
            );
        }
    }
}
