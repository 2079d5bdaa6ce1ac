//! Configuration of an experiment, as in `configs/reproduce/`.

use crate::cli;
use crate::commands::eval::ORACLE;
use crate::config::Config;
use crate::error::bad_input;
use anyhow::{Context, Result, anyhow};
use datagen::DatasetConfig;
use eval::EvalConfig;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use train::config::TrainConfig;

/// Configuration of all stages.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ExperimentConfig {
    /// Datasets by name.
    pub(crate) datasets: BTreeMap<String, DatasetConfig>,
    /// Networks by name. Their `datasets` are keys of the map above.
    pub(crate) training: BTreeMap<String, TrainConfig>,
    /// Servo sessions. The policies are replaced by those of each system.
    pub(crate) evaluation: EvalConfig,
    /// Rows of Table 1. The figures show the first system.
    pub(crate) systems: Vec<SystemConfig>,
}

/// A row of Table 1: the two networks of a system.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct SystemConfig {
    /// Name in the tables.
    pub(crate) name: String,
    /// Key of `training`, or `oracle`.
    pub(crate) approach: String,
    /// Key of `training`, or `oracle`.
    pub(crate) avoid: String,
}

impl ExperimentConfig {
    /// Reads and checks the preset that the command line selects.
    pub(crate) fn load(arguments: &cli::Reproduce) -> Result<Self> {
        let path = arguments.configs.join("reproduce").join(format!("{}.toml", arguments.preset.name()));
        if !path.exists() {
            return Err(bad_input(anyhow!(
                "{} does not exist; run this command in the root of the repository, or set the folder of its configurations \
                 with --configs (now: {})",
                path.display(),
                arguments.configs.display()
            )));
        }
        let file = Config::load(&path, &arguments.overrides)?;
        let config: Self = file.parse()?;
        config.check(&file)?;
        Ok(config)
    }

    /// Checks all stages, so that errors are found before any stage runs.
    fn check(&self, file: &Config) -> Result<()> {
        for (name, dataset) in &self.datasets {
            file.check(dataset.validate()).with_context(|| format!("datasets.{name}"))?;
        }
        for (name, training) in &self.training {
            file.check(training.task()).with_context(|| format!("training.{name}"))?;
            self.check_sources(name, training).map_err(bad_input)?;
        }
        file.check(self.evaluation.validate()).context("evaluation")?;
        self.check_systems().map_err(bad_input)
    }

    /// Checks that a network depends only on the datasets of this configuration.
    fn check_sources(&self, name: &str, training: &TrainConfig) -> Result<()> {
        if let Some(parent) = &training.parent {
            return Err(anyhow!(
                "training.{name}.parent = {parent:?}: not supported by `reproduce`, which trains every network from scratch; use \
                 `flowservo train` to start from a model"
            ));
        }
        for dataset in &training.datasets {
            let known = dataset.to_str().is_some_and(|dataset| self.datasets.contains_key(dataset));
            let unknown = || format!("training.{name}.datasets: unknown dataset {}", dataset.display());
            known.then_some(()).with_context(unknown)?;
        }
        Ok(())
    }

    /// Checks that the networks of all systems exist.
    fn check_systems(&self) -> Result<()> {
        for system in &self.systems {
            for policy in [&system.approach, &system.avoid] {
                let known = policy == ORACLE || self.training.contains_key(policy);
                let unknown = || format!("systems: {}: unknown network {policy}", system.name);
                known.then_some(()).with_context(unknown)?;
            }
        }
        (!self.systems.is_empty()).then_some(()).context("systems: at least one is required")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn the_shipped_presets_pass_all_checks() {
        for preset in ["quick", "cpu", "paper"] {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("configs/reproduce/{preset}.toml"));
            let file = Config::load(&path, &[]).unwrap();
            let config: ExperimentConfig = file.parse().unwrap();
            config.check(&file).unwrap();
            let mut with_parent = config.clone();
            for training in with_parent.training.values_mut() {
                training.parent = Some("approach@1".to_owned());
            }
            let rejected = with_parent.check(&file).unwrap_err().to_string();
            assert!(rejected.contains("parent = \"approach@1\""), "{rejected}");
            // The 52,000 examples of the paper, in its ratio.
            let counts = ["a", "b", "c"].map(|name| config.datasets[name].count);
            assert_eq!(counts, [20_000, 20_000, 12_000], "{preset}");
            // Networks are evaluated with the camera of their training images.
            assert!(
                config.datasets.values().all(|dataset| dataset.world == config.evaluation.world),
                "{preset}"
            );
        }
    }
}
