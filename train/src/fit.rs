//! The training loop: forward, loss, backward, clip, step; validation and a checkpoint after every epoch.
//!
//! All it does is a function of the configuration, the examples and where it stands ([`Place`]). So a run that was
//! stopped anywhere, or killed, continues to the same weights, on the CPU to the bit.
//!
//! ```text
//! config.toml     the configuration
//! metrics.jsonl   one line an epoch
//! last/           checkpoint with the optimizer's state, from which to resume
//! best/           checkpoint of the epoch with the lowest validation loss
//! ```

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use burn::module::Module;
use burn::tensor::Device;
use serde::{Deserialize, Serialize};

use crate::adamw::{AdamW, Step};
use crate::batch::Images;
use crate::checkpoint::{self, Checkpoint, Contents, ModelInfo};
use crate::config::{Task, TrainConfig};
use crate::error::{Error, Result};
use crate::examples::Examples;
use crate::history;
use crate::loss::mean_squared_error;
use crate::metric::Metrics;
use crate::network::Network;
use crate::pretrained::{self, Imported};
use crate::publish::{self, at};
use crate::schedule::OneCycle;
use crate::split::Split;
use crate::targets::Targets;

/// A training run.
#[derive(Debug)]
pub struct Run<'a> {
    /// What is done.
    pub config: &'a TrainConfig,
    /// Where the results go.
    pub directory: &'a Path,
    /// Where it is computed.
    pub device: &'a Device,
    /// Continue the run in `directory` instead of starting one there.
    pub resume: bool,
    /// Looked at before every batch: if set, the state is saved and the run ends with [`Error::Interrupted`].
    pub stop: &'a AtomicBool,
}

/// News from a run.
#[derive(Debug)]
pub enum Progress<'a> {
    /// The network begins from published weights.
    Imported(&'a Imported),
    /// A step was taken.
    Step {
        /// Epoch, from 1, and number of epochs.
        epoch: [usize; 2],
        /// Batch within the epoch, from 1, and number of batches an epoch.
        batch: [usize; 2],
        /// Examples of the batch.
        examples: usize,
        /// Loss of the batch before the step.
        loss: f64,
    },
    /// An epoch is complete, and saved.
    Epoch(&'a EpochRecord),
}

/// A line of `metrics.jsonl`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpochRecord {
    /// Epoch, from 1.
    pub epoch: usize,
    /// Steps since the start of the run.
    pub steps: usize,
    /// Learning rate of the last step.
    pub learning_rate: f64,
    /// Mean loss of the epoch's batches, each before its step.
    pub training_loss: f64,
    /// Greatest norm of a gradient in the epoch, before clipping.
    pub gradient_norm: f64,
    /// On the validation set, after the epoch.
    #[serde(flatten)]
    pub validation: Metrics,
}

/// A run that came to its end.
#[derive(Debug)]
pub struct Fitted {
    /// Checkpoint of the best epoch.
    pub checkpoint: PathBuf,
    /// The best epoch.
    pub best: EpochRecord,
    /// The last epoch.
    pub last: EpochRecord,
}

/// Where a run stands.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Place {
    /// Complete epochs.
    epoch: usize,
    /// Steps taken in the epoch that is not complete.
    batch: usize,
    /// Sum of their losses.
    loss_sum: f64,
    /// Greatest norm of their gradients.
    gradient_norm: f64,
    /// The last complete epoch.
    last: Option<EpochRecord>,
    /// The complete epoch with the lowest validation loss.
    best: Option<EpochRecord>,
}

/// What a step changes.
struct State {
    network: Network,
    optimizer: AdamW,
    place: Place,
    /// SHA-256 of the file of published weights from which it began.
    pretrained: Option<String>,
}

/// Trains a network, or continues to.
pub fn fit(run: &Run, examples: &Examples, progress: &mut dyn FnMut(Progress)) -> Result<Fitted> {
    let task = run.config.task()?;
    let split = Split::new(run.config.seed, run.config.validation, &examples.ranges());
    if split.training.is_empty() {
        return Err(Error::TooFewExamples { found: examples.len(), needed: 1 + examples.sources().len() });
    }
    let targets = Targets::new(&task, examples, &split.training)?;
    let batches = (split.training.len() / run.config.optimizer.batch).max(1);
    let schedule = OneCycle::new(&run.config.optimizer, run.config.optimizer.epochs * batches);
    let training = Training { run, task, examples, split, targets, batches, schedule };
    let mut state = if run.resume { training.resumed()? } else { training.started(progress)? };
    while state.place.epoch < run.config.optimizer.epochs {
        state = training.epoch(state, progress)?;
        if let Some(record) = &state.place.last {
            progress(Progress::Epoch(record));
        }
    }
    let (Some(best), Some(last)) = (state.place.best, state.place.last) else {
        unreachable!("a configuration has at least one epoch");
    };
    Ok(Fitted { checkpoint: training.best(), best, last })
}

/// What a step does not change.
struct Training<'a> {
    run: &'a Run<'a>,
    task: Task,
    examples: &'a Examples,
    split: Split,
    targets: Targets<'a>,
    /// Batches an epoch. What remains of the examples waits for another epoch's order.
    batches: usize,
    schedule: OneCycle,
}

impl Training<'_> {
    fn last(&self) -> PathBuf {
        self.run.directory.join("last")
    }

    fn best(&self) -> PathBuf {
        self.run.directory.join("best")
    }

    fn device(&self) -> Device {
        self.run.device.clone().autodiff()
    }

    fn started(&self, progress: &mut dyn FnMut(Progress)) -> Result<State> {
        let Run { config, directory, .. } = *self.run;
        publish::recover(&self.last())?;
        if self.last().exists() {
            return Err(Error::RunExists { directory: directory.to_owned() });
        }
        let mut network = Network::new(&self.task, config.seed, &self.device());
        let mut pretrained = None;
        if let Some(path) = &config.pretrained {
            let imported = pretrained::import(path, &mut network, &self.device())?;
            progress(Progress::Imported(&imported));
            pretrained = Some(imported.sha256);
        }
        std::fs::create_dir_all(directory).map_err(at(directory))?;
        checkpoint::write_config(&directory.join("config.toml"), config)?;
        history::keep(directory, 0)?;
        let optimizer = AdamW::new(&network, config.optimizer.weight_decay);
        Ok(State { network, optimizer, place: Place::default(), pretrained })
    }

    fn resumed(&self) -> Result<State> {
        let Run { config, directory, .. } = *self.run;
        publish::recover(&self.last())?;
        publish::recover(&self.best())?;
        if !self.last().exists() {
            return Err(Error::NothingToResume { directory: directory.to_owned() });
        }
        let checkpoint = Checkpoint::load(&self.last(), &self.device())?;
        let other = config.difference(&checkpoint::load_config(&self.last())?).or_else(|| {
            let (was, is) = (&checkpoint.info.datasets, self.examples.sources());
            (was != is).then(|| ["datasets".to_owned(), format!("{was:?}"), format!("{is:?}")])
        });
        if let Some([key, was, is]) = other {
            return Err(Error::OtherRun { directory: directory.to_owned(), key, was, is });
        }
        let optimizer = AdamW::new(&checkpoint.network, config.optimizer.weight_decay);
        let (optimizer, place) = checkpoint::load_training(&self.last(), optimizer)?;
        history::keep(directory, place.epoch)?;
        let pretrained = checkpoint.info.pretrained_sha256;
        Ok(State { network: checkpoint.network, optimizer, place, pretrained })
    }

    /// From wherever the state stands to the end of its epoch.
    fn epoch(&self, mut state: State, progress: &mut dyn FnMut(Progress)) -> Result<State> {
        let Run { config, stop, .. } = *self.run;
        let order = self.split.order(config.seed, state.place.epoch);
        let batches = order.chunks(config.optimizer.batch).take(self.batches);
        for indices in batches.skip(state.place.batch) {
            if stop.load(Ordering::Relaxed) {
                return Err(self.interrupted(&state));
            }
            let loss_before = state.place.loss_sum;
            state = self.step(state, indices)?;
            progress(Progress::Step {
                epoch: [state.place.epoch + 1, config.optimizer.epochs],
                batch: [state.place.batch, self.batches],
                examples: indices.len(),
                loss: state.place.loss_sum - loss_before,
            });
        }
        match self.validated(&state.network) {
            Some(metrics) => self.completed(state, metrics),
            None => Err(self.interrupted(&state)),
        }
    }

    fn step(&self, state: State, indices: &[usize]) -> Result<State> {
        let State { network, mut optimizer, mut place, pretrained } = state;
        let device = self.device();
        let outputs = network.forward(Images::of(self.examples, indices, &device));
        let loss = mean_squared_error(outputs, self.targets.tensor(indices, &device));
        let clip = self.run.config.optimizer.gradient_clip;
        let Step { network, loss, gradient_norm: norm } =
            optimizer.step(network, loss, self.rate(&place), clip);
        if !(loss.is_finite() && norm.is_finite()) {
            return Err(self.not_finite(&place, loss, norm));
        }
        place.batch += 1;
        place.loss_sum += loss;
        place.gradient_norm = place.gradient_norm.max(norm);
        Ok(State { network, optimizer, place, pretrained })
    }

    /// Learning rate of the next step.
    fn rate(&self, place: &Place) -> f64 {
        self.schedule.rate(place.epoch * self.batches + place.batch)
    }

    /// What the network achieves on the examples held out; none if it was stopped meanwhile.
    fn validated(&self, network: &Network) -> Option<Metrics> {
        let network = network.valid();
        let mut outputs = Vec::new();
        for indices in self.split.validation.chunks(self.run.config.optimizer.batch) {
            if self.run.stop.load(Ordering::Relaxed) {
                return None;
            }
            let output = network.forward(Images::of(self.examples, indices, &self.device().inner()));
            outputs.extend(output.into_data().iter::<f32>());
        }
        Some(self.targets.metrics(&self.split.validation, &outputs))
    }

    /// Closes an epoch: record, best, last, in this order, so that a crash between them repeats the epoch.
    fn completed(&self, mut state: State, validation: Metrics) -> Result<State> {
        let place = &state.place;
        if !validation.loss().is_finite() {
            return Err(self.not_finite(place, validation.loss(), place.gradient_norm));
        }
        let record = EpochRecord {
            epoch: place.epoch + 1,
            steps: (place.epoch + 1) * self.batches,
            learning_rate: self.schedule.rate((place.epoch + 1) * self.batches - 1),
            training_loss: place.loss_sum / self.batches as f64,
            gradient_norm: place.gradient_norm,
            validation,
        };
        history::append(self.run.directory, &record)?;
        let better = |best: &EpochRecord| record.validation.loss() < best.validation.loss();
        let is_best = place.best.as_ref().is_none_or(better);
        let best = if is_best { Some(record.clone()) } else { place.best.clone() };
        state.place = Place { epoch: record.epoch, last: Some(record), best, ..Place::default() };
        if is_best {
            self.contents(&state).save(&self.best())?;
        }
        self.save_last(&state)?;
        Ok(state)
    }

    fn contents<'a>(&'a self, state: &'a State) -> Contents<'a> {
        let info = ModelInfo::new(&self.task, self.examples, self.targets.standardization());
        let (epoch, pretrained_sha256) = (state.place.last.clone(), state.pretrained.clone());
        let info = ModelInfo { seed: self.run.config.seed, epoch, pretrained_sha256, ..info };
        Contents { info, config: self.run.config, network: &state.network, training: None }
    }

    fn save_last(&self, state: &State) -> Result<()> {
        let training = Some((&state.optimizer, &state.place));
        Contents { training, ..self.contents(state) }.save(&self.last())
    }

    fn interrupted(&self, state: &State) -> Error {
        let (epoch, epochs) = (state.place.epoch + 1, self.run.config.optimizer.epochs);
        match self.save_last(state) {
            Ok(()) => Error::Interrupted { epoch, epochs, checkpoint: self.last() },
            Err(error) => error,
        }
    }

    fn not_finite(&self, place: &Place, loss: f64, gradient_norm: f64) -> Error {
        Error::NotFinite {
            epoch: place.epoch + 1,
            batch: (place.batch + 1).min(self.batches),
            learning_rate: self.rate(place),
            loss,
            gradient_norm,
            checkpoint: Some(self.last()).filter(|last| last.exists()),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use datagen::Kind;

    use super::*;
    use crate::config::tests::tiny;
    use crate::examples::tests::squares;

    /// Runs a configuration in a directory, and stops it before step `stop_at`, counted from the start of this call.
    fn run(config: &TrainConfig, directory: &Path, resume: bool, stop_at: Option<usize>) -> Result<Fitted> {
        let (device, stop) = (Device::flex(), AtomicBool::new(stop_at == Some(0)));
        let examples = squares(&config.task()?, 32);
        let mut steps = 0;
        let run = Run { config, directory, device: &device, resume, stop: &stop };
        fit(&run, &examples, &mut |progress| {
            steps += usize::from(matches!(progress, Progress::Step { .. }));
            stop.store(Some(steps) == stop_at, Ordering::Relaxed);
        })
    }

    /// Digests of what a run leaves.
    fn left(directory: &Path) -> [String; 5] {
        let optimizer = "last/optimizer.safetensors";
        ["last/weights.safetensors", optimizer, "last/model.json", "best/model.json", "metrics.jsonl"]
            .map(|name| datagen::publish::digest(&fs::read(directory.join(name)).unwrap()))
    }

    #[test]
    fn the_loss_falls_on_both_tasks() {
        for kind in [Kind::Approach, Kind::Avoidance] {
            let directory = tempfile::tempdir().unwrap();
            let mut config = tiny(kind);
            config.optimizer.epochs = 20;
            let fitted = run(&config, directory.path(), false, None).unwrap();
            let history = history::read(directory.path()).unwrap();
            assert_eq!(history.len(), 20);
            assert_eq!(history.last(), Some(&fitted.last));
            let [first, last] = [&history[0], &fitted.last].map(|record| record.training_loss);
            assert!(last < 0.5 * first, "{kind}: {first} to {last}");
            let lowest = history.iter().map(|record| record.validation.loss()).fold(f64::INFINITY, f64::min);
            assert!(fitted.best.validation.loss() <= lowest);
        }
    }

    #[test]
    fn the_same_seed_gives_the_same_run_and_another_seed_another() {
        let directories: [_; 3] = std::array::from_fn(|_| tempfile::tempdir().unwrap());
        let mut config = tiny(Kind::Approach);
        config.optimizer.epochs = 2;
        run(&config, directories[0].path(), false, None).unwrap();
        run(&config, directories[1].path(), false, None).unwrap();
        config.seed += 1;
        run(&config, directories[2].path(), false, None).unwrap();
        let [a, b, c] = directories.each_ref().map(|directory| left(directory.path()));
        assert_eq!(a, b);
        assert_ne!(a[0], c[0]);
    }

    #[test]
    fn a_run_that_was_stopped_anywhere_ends_like_one_that_was_not() {
        let whole = tempfile::tempdir().unwrap();
        let config = tiny(Kind::Approach);
        run(&config, whole.path(), false, None).unwrap();
        // 24 training examples are 6 steps an epoch: within an epoch, between two, and before the first step.
        for stops in [vec![3], vec![12], vec![0, 5, 7]] {
            let parts = tempfile::tempdir().unwrap();
            for (i, &stop) in stops.iter().enumerate() {
                let error = run(&config, parts.path(), i > 0, Some(stop)).unwrap_err();
                assert!(matches!(error, Error::Interrupted { .. }), "{error}");
            }
            run(&config, parts.path(), true, None).unwrap();
            assert_eq!(left(whole.path()), left(parts.path()), "{stops:?}");
        }
    }

    #[test]
    fn a_killed_run_repeats_what_it_had_not_saved() {
        let [whole, killed] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let config = tiny(Kind::Avoidance);
        run(&config, whole.path(), false, None).unwrap();
        run(&config, killed.path(), false, Some(6)).unwrap_err();
        // Killed between two renames, after an epoch was recorded but not saved, in the middle of a line.
        fs::rename(killed.path().join("last"), killed.path().join("last.previous")).unwrap();
        fs::create_dir(killed.path().join("last.partial")).unwrap();
        let lines = fs::read_to_string(whole.path().join("metrics.jsonl")).unwrap();
        fs::write(killed.path().join("metrics.jsonl"), &lines[..lines.len() / 2]).unwrap();
        run(&config, killed.path(), true, None).unwrap();
        assert_eq!(left(whole.path()), left(killed.path()));
        // A complete run has nothing left to do.
        let again = run(&config, killed.path(), true, None).unwrap();
        assert_eq!(again.last.epoch, 4);
    }

    #[test]
    fn a_run_is_neither_overwritten_nor_confused_with_another() {
        let directory = tempfile::tempdir().unwrap();
        let mut config = tiny(Kind::Avoidance);
        config.optimizer.epochs = 1;
        let nothing = run(&config, directory.path(), true, None).unwrap_err();
        assert!(matches!(nothing, Error::NothingToResume { .. }));
        run(&config, directory.path(), false, None).unwrap();
        assert!(matches!(run(&config, directory.path(), false, None), Err(Error::RunExists { .. })));
        config.optimizer.learning_rate = 0.01;
        let other = run(&config, directory.path(), true, None).unwrap_err();
        assert!(matches!(&other, Error::OtherRun { key, .. } if key == "optimizer.learning_rate"), "{other}");
        config.optimizer.learning_rate = tiny(Kind::Avoidance).optimizer.learning_rate;
        fs::write(directory.path().join("last/optimizer.safetensors"), "damaged").unwrap();
        let damaged = run(&config, directory.path(), true, None).unwrap_err();
        assert!(
            matches!(&damaged, Error::Digest { path, .. } if path.ends_with("optimizer.safetensors")),
            "{damaged}"
        );
    }

    #[test]
    fn divergence_is_an_error_that_names_the_place() {
        let directory = tempfile::tempdir().unwrap();
        let mut config = tiny(Kind::Approach);
        // Decay by the whole weight and steps of size one blow the network up.
        config.optimizer =
            crate::config::OptimizerConfig { learning_rate: 1.0, warmup: 0.0, ..config.optimizer };
        config.optimizer.epochs = 400;
        let error = run(&config, directory.path(), false, None).unwrap_err();
        assert!(matches!(error, Error::NotFinite { .. }), "{error}");
        assert!(error.to_string().contains("optimizer.learning_rate"), "{error}");
    }

    #[test]
    fn too_few_examples_are_refused() {
        let directory = tempfile::tempdir().unwrap();
        let config = tiny(Kind::Approach);
        let (device, stop) = (Device::flex(), AtomicBool::new(false));
        let run =
            Run { config: &config, directory: directory.path(), device: &device, resume: false, stop: &stop };
        let error = fit(&run, &squares(&config.task().unwrap(), 1), &mut |_| ()).unwrap_err();
        assert!(matches!(error, Error::TooFewExamples { found: 1, needed: 2 }), "{error}");
    }
}
