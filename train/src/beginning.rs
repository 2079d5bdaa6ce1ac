//! How a run begins: with random weights, published ones, or a parent's; or where it stopped.

use crate::adamw::AdamW;
use crate::camera;
use crate::checkpoint::{self, Checkpoint, ModelInfo};
use crate::config::Task;
use crate::error::{Error, Result};
use crate::examples::{Examples, Source};
use crate::fit::{Progress, Run, State, can_resume, last};
use crate::network::Network;
use crate::normalization::Standardization;
use crate::place::Place;
use crate::pretrained;
use crate::publish;
use crate::warm_start::Parent;

/// What a run begins with.
pub(crate) struct Beginning {
    pub(crate) state: State,
    /// Of the outputs, where the weights come with one; without it the labels decide.
    pub(crate) standardization: Option<Standardization>,
    pub(crate) origin: Origin,
    /// The device of the steps before, if it is another one.
    pub(crate) other_device: Option<String>,
}

/// What the first weights came from.
#[derive(Default)]
pub(crate) struct Origin {
    /// SHA-256 of the file of published weights.
    pub(crate) pretrained_sha256: Option<String>,
    pub(crate) parent: Option<Parent>,
}

impl Beginning {
    /// Of a new run.
    pub(crate) fn started(
        run: &Run,
        task: &Task,
        examples: &Examples,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<Self> {
        let Run { config, directory, warm_start, .. } = *run;
        assert_eq!(config.parent.is_some(), warm_start.is_some(), "the model that `parent` names");
        if can_resume(directory) {
            return Err(Error::RunExists { directory: directory.to_owned() });
        }
        let device = run.autodiff();
        let mut origin = Origin::default();
        let (network, standardization) = if let Some(start) = warm_start {
            let (checkpoint, parent) = start.load(task, &device)?;
            let other_camera = camera::difference(&checkpoint.info.camera, examples.camera());
            progress(Progress::WarmStart { parent: start, other_camera });
            origin.parent = Some(parent);
            (checkpoint.network, checkpoint.info.standardization)
        } else {
            let mut network = Network::new(task, config.seed, &device);
            if let Some(path) = &config.pretrained {
                let imported = pretrained::import(path, &mut network, &device)?;
                progress(Progress::Imported(&imported));
                origin.pretrained_sha256 = Some(imported.sha256);
            }
            (network, None)
        };
        let optimizer = AdamW::new(&network, config.optimizer.weight_decay);
        let state = State { network, optimizer, place: Place::default() };
        Ok(Self { state, standardization, origin, other_device: None })
    }

    /// Of a run that goes on from its `last` checkpoint, and needs nothing else.
    pub(crate) fn resumed(run: &Run, examples: &Examples) -> Result<Self> {
        let last = last(run.directory);
        publish::recover(&last)?;
        publish::recover(&run.directory.join("best"))?;
        if !last.exists() {
            return Err(Error::NothingToResume { directory: run.directory.to_owned() });
        }
        let Checkpoint { info, network, .. } = Checkpoint::load(&last, &run.autodiff())?;
        if let Some([key, was, is]) = difference(run, &info, examples)? {
            return Err(Error::OtherRun { directory: run.directory.to_owned(), key, was, is });
        }
        let optimizer = AdamW::new(&network, run.config.optimizer.weight_decay);
        let (optimizer, place) = checkpoint::load_training(&last, optimizer)?;
        Ok(Self {
            state: State { network, optimizer, place },
            standardization: info.standardization,
            origin: Origin { pretrained_sha256: info.pretrained_sha256, parent: info.parent },
            other_device: info.device.filter(|device| device != run.device_name),
        })
    }
}

/// What keeps a run from being the one of a checkpoint: a key, its value there and here.
fn difference(run: &Run, there: &ModelInfo, examples: &Examples) -> Result<Option<[String; 3]>> {
    let config = run.config.difference(&checkpoint::load_config(&last(run.directory))?);
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
