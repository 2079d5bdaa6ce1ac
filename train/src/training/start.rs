//! The starting point of a run: random weights, published weights, a parent model, or the checkpoint to resume from.

use super::event::Event;
use super::learner::Learner;
use super::run::{Run, can_resume};
use crate::checkpoint::files::read_config;
use crate::checkpoint::lineage::InitialWeights;
use crate::checkpoint::load::Checkpoint;
use crate::checkpoint::model_info::ModelInfo;
use crate::checkpoint::training_state::TrainingState;
use crate::checkpoint::{pretrained, publish};
use crate::data::camera;
use crate::data::examples::{Examples, Source};
use crate::data::standardization::Standardization;
use crate::error::{Error, Result};
use crate::network::Network;
use crate::network::task::Task;
use crate::optimizer::adamw::AdamW;

/// The starting point of a run.
pub(crate) struct Start {
    pub(crate) learner: Learner,
    /// Standardization that belongs to the weights. Without it, it is computed from the labels.
    pub(crate) standardization: Option<Standardization>,
    pub(crate) initial_weights: InitialWeights,
    /// Device of the previous steps, if it is a different one.
    pub(crate) other_device: Option<String>,
}

impl Start {
    /// Starts a new run.
    pub(crate) fn new_run(
        run: &Run,
        task: &Task,
        examples: &Examples,
        report: &mut dyn FnMut(Event),
    ) -> Result<Self> {
        let Run { config, directory, warm_start, .. } = *run;
        assert_eq!(config.parent.is_some(), warm_start.is_some(), "the model that `parent` names");
        if can_resume(directory) {
            return Err(Error::RunExists { directory: directory.to_owned() });
        }
        let device = run.autodiff();
        let mut initial_weights = InitialWeights::default();
        let (network, standardization) = if let Some(start) = warm_start {
            let (checkpoint, parent) = start.load(task, &device)?;
            let other_camera = camera::difference(&checkpoint.info.camera, examples.camera());
            report(Event::WarmStart { parent: start, other_camera });
            initial_weights.parent = Some(parent);
            (checkpoint.network, checkpoint.info.standardization)
        } else {
            let mut network = Network::new(task.architecture(), config.seed, &device);
            if let Some(path) = &config.pretrained {
                let imported = pretrained::import(path, &mut network, &device)?;
                report(Event::Imported(&imported));
                initial_weights.pretrained_sha256 = Some(imported.sha256);
            }
            (network, None)
        };
        let optimizer = AdamW::new(&network, config.optimizer.weight_decay);
        let learner = Learner { network, optimizer, state: TrainingState::default() };
        Ok(Self { learner, standardization, initial_weights, other_device: None })
    }

    /// Resumes a run from its `last` checkpoint, which is all it needs.
    pub(crate) fn resume(run: &Run, examples: &Examples) -> Result<Self> {
        let last = run.last();
        publish::recover(&last)?;
        publish::recover(&run.best())?;
        if !last.exists() {
            return Err(Error::NothingToResume { directory: run.directory.to_owned() });
        }
        let Checkpoint { info, network, .. } = Checkpoint::load(&last, &run.autodiff())?;
        if let Some([key, was, is]) = difference(run, &info, examples)? {
            return Err(Error::OtherRun { directory: run.directory.to_owned(), key, was, is });
        }
        let mut optimizer = AdamW::new(&network, run.config.optimizer.weight_decay);
        let state = TrainingState::read(&last, &mut optimizer)?;
        Ok(Self {
            learner: Learner { network, optimizer, state },
            standardization: info.standardization,
            initial_weights: InitialWeights {
                pretrained_sha256: info.pretrained_sha256,
                parent: info.parent,
            },
            other_device: info.device.filter(|device| device != run.device_name),
        })
    }
}

/// Returns the first difference between a run and the one of a checkpoint: dotted key, its value there and here.
fn difference(run: &Run, there: &ModelInfo, examples: &Examples) -> Result<Option<[String; 3]>> {
    let config = run.config.difference(&read_config(&run.last())?);
    let camera = || {
        let (key, was, is) = camera::difference(&there.camera, examples.camera())?;
        Some([format!("camera.{key}"), was.to_string(), is.to_string()])
    };
    let datasets = || {
        let [was, is] = [&there.datasets, examples.sources()].map(|sources| {
            let named = |source: &Source| format!("{} (digest {})", source.name, source.digest);
            sources.iter().map(named).collect::<Vec<_>>().join(", ")
        });
        (was != is).then(|| ["datasets".to_owned(), was, is])
    };
    Ok(config.or_else(camera).or_else(datasets))
}
