//! The training loop: forward, loss, backward, clip, step; validation after every epoch, checkpoints within and after it.
//!
//! All it does is a function of the configuration, the examples and where it stands (`Place`). So a run that was
//! stopped anywhere, or killed, continues to the same weights, on the CPU to the bit.
//!
//! ```text
//! config.toml     the configuration
//! metrics.jsonl   one line an epoch
//! tensorboard/    the same and single steps, as TensorBoard's event files
//! last/           checkpoint with the optimizer's state, from which to resume
//! best/           checkpoint of the epoch with the lowest validation loss
//! ```

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use burn::module::Module;
use burn::tensor::Device;

use crate::adamw::AdamW;
use crate::batch::{self, Batch};
use crate::beginning::{Beginning, Origin};
use crate::checkpoint::{self, Contents, ModelInfo, Program, Resumption};
use crate::config::{Task, TrainConfig};
use crate::error::{Error, Result};
use crate::examples::Examples;
use crate::history::EpochRecord;
use crate::journal::{Gauge, Journal, Step};
use crate::loss::mean_squared_error;
use crate::metric::Metrics;
use crate::network::Network;
use crate::phase::Phase;
use crate::place::Place;
use crate::pretrained::Imported;
use crate::publish::{self, at};
use crate::split::Split;
use crate::targets::Targets;
use crate::warm_start::WarmStart;

/// A training run.
pub struct Run<'a> {
    /// What is done.
    pub config: &'a TrainConfig,
    /// Where the results go.
    pub directory: &'a Path,
    /// Where it is computed.
    pub device: &'a Device,
    /// How people call the device.
    pub device_name: &'a str,
    /// What computes it, if checkpoints shall say so.
    pub program: Option<&'a Program>,
    /// The model that [`parent`](TrainConfig::parent) names, which a new run begins from.
    pub warm_start: Option<&'a WarmStart>,
    /// Continue the run in `directory` instead of starting one there.
    pub resume: bool,
    /// Looked at before every batch: if set, the state is saved and the run ends with [`Error::Interrupted`].
    pub stop: &'a AtomicBool,
    /// The clock and the memory, for the journal alone.
    pub gauge: &'a dyn Fn() -> Gauge,
}

/// News from a run.
#[derive(Debug)]
pub enum Progress<'a> {
    /// The network begins from published weights.
    Imported(&'a Imported),
    /// The network begins as the parent's.
    WarmStart {
        /// The parent.
        parent: &'a WarmStart,
        /// If its camera showed other things: a property, its value there and here.
        other_camera: Option<(&'static str, f64, f64)>,
    },
    /// The run begins, or goes on from a checkpoint.
    Begun {
        /// Complete epochs.
        epochs: usize,
        /// Steps taken.
        steps: usize,
        /// Steps of the whole run, if no phase ends early.
        planned: usize,
        /// The device of the steps before, if it is another one: only on one CPU are results the same to the bit.
        other_device: Option<String>,
    },
    /// A step was taken.
    Step {
        /// Epoch, from 1, and number of epochs, if no phase ends early.
        epoch: [usize; 2],
        /// Steps taken in the run, and number of steps, if no phase ends early.
        step: [usize; 2],
        /// Examples of the batch.
        examples: usize,
        /// Loss of the batch before the step.
        loss: f64,
    },
    /// An epoch is complete, and saved.
    Epoch(&'a EpochRecord),
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
    /// Mean training loss of successive groups of batches, each behind the epochs that were done at the group's end.
    pub losses: Vec<[f64; 2]>,
}

/// What a step changes.
pub(crate) struct State {
    pub(crate) network: Network,
    pub(crate) optimizer: AdamW,
    pub(crate) place: Place,
}

/// Is there a run in this directory that can be continued?
pub fn can_resume(directory: &Path) -> bool {
    publish::recover(&last(directory)).is_ok() && last(directory).exists()
}

/// Trains a network, or continues to.
///
/// # Panics
/// If a new run has a [`warm_start`](Run::warm_start) and its configuration no `parent`, or the other way round.
pub fn fit(run: &Run, examples: &Examples, progress: &mut dyn FnMut(Progress)) -> Result<Fitted> {
    let task = run.config.task()?;
    let split = Split::new(run.config.seed, run.config.validation, &examples.ranges());
    let batch = run.config.optimizer.batch;
    let phases: Result<_> = run.config.phases.iter().map(|phase| Phase::new(phase, batch, &split)).collect();
    let phases: Vec<Phase> = phases?;
    let beginning = if run.resume {
        Beginning::resumed(run, examples)?
    } else {
        Beginning::started(run, &task, examples, progress)?
    };
    let Beginning { mut state, standardization, origin, other_device } = beginning;
    let targets = Targets::new(&task, examples, &split.learned(), standardization)?;
    if !run.resume {
        std::fs::create_dir_all(run.directory).map_err(at(run.directory))?;
        checkpoint::write_config(&run.directory.join("config.toml"), run.config)?;
    }
    let training = Training { run, task, examples, split, targets, phases, origin };
    let Place { epoch: epochs, steps, .. } = state.place;
    progress(Progress::Begun {
        epochs,
        steps,
        planned: state.place.planned(&training.phases)[0],
        other_device,
    });
    let mut journal = Journal::open(run.directory, run.gauge, &state.place)?;
    while let Some(phase) = training.phases.get(state.place.phase) {
        state = training.epoch(state, phase, &mut journal, progress)?;
        if let Some(record) = &state.place.last {
            progress(Progress::Epoch(record));
        }
    }
    let Place { best: Some(best), last: Some(last), losses, .. } = state.place else {
        unreachable!("a configuration has at least one epoch");
    };
    Ok(Fitted { checkpoint: training.best(), best, last, losses: losses.points })
}

pub(crate) fn last(directory: &Path) -> PathBuf {
    directory.join("last")
}

impl Run<'_> {
    /// Where it is learned.
    pub(crate) fn autodiff(&self) -> Device {
        self.device.clone().autodiff()
    }
}

/// What a step does not change.
struct Training<'a> {
    run: &'a Run<'a>,
    task: Task,
    examples: &'a Examples,
    split: Split,
    targets: Targets<'a>,
    phases: Vec<Phase>,
    origin: Origin,
}

impl Training<'_> {
    fn last(&self) -> PathBuf {
        last(self.run.directory)
    }

    fn best(&self) -> PathBuf {
        self.run.directory.join("best")
    }

    /// From wherever the state stands to the end of its epoch.
    fn epoch(
        &self,
        mut state: State,
        phase: &Phase,
        journal: &mut Journal,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<State> {
        let Run { config, stop, .. } = *self.run;
        let [steps, epochs] = state.place.planned(&self.phases);
        let order = self.split.order(config.seed, state.place.epoch, &phase.counts);
        let batches = order.chunks(config.optimizer.batch).take(phase.batches).skip(state.place.batch);
        journal.begin_epoch();
        let state = batch::ahead(self.examples, batches, |batches| {
            for batch in batches {
                if stop.load(Ordering::Relaxed) {
                    return Err(self.interrupted(&state));
                }
                let batch = batch?;
                let step;
                (state, step) = self.step(state, phase, &batch)?;
                let place = &mut state.place;
                place.step(step.loss, step.gradient_norm);
                let epochs_done = place.epoch as f64 + place.batch as f64 / phase.batches as f64;
                place.losses.add(step.loss, epochs_done, steps);
                journal.step(place, batch.indices.len(), &step)?;
                if place.steps.is_multiple_of(config.checkpoint_steps) && place.batch < phase.batches {
                    self.save_last(&state)?;
                }
                progress(Progress::Step {
                    epoch: [state.place.epoch + 1, epochs],
                    step: [state.place.steps, steps],
                    examples: batch.indices.len(),
                    loss: step.loss,
                });
            }
            Ok(state)
        })?;
        match self.validated(&state.network)? {
            Some(metrics) => self.completed(state, phase, metrics, journal),
            None => Err(self.interrupted(&state)),
        }
    }

    fn step(&self, state: State, phase: &Phase, batch: &Batch) -> Result<(State, Step)> {
        let State { network, mut optimizer, place } = state;
        let device = self.run.autodiff();
        let outputs = network.forward(batch.images(&device));
        let loss = mean_squared_error(outputs, self.targets.tensor(batch.indices, &device));
        let learning_rate = phase.rate(place.phase_steps(phase));
        let taken = optimizer.step(network, loss, learning_rate, self.run.config.optimizer.gradient_clip);
        let step = Step { loss: taken.loss, learning_rate, gradient_norm: taken.gradient_norm };
        if !(step.loss.is_finite() && step.gradient_norm.is_finite()) {
            return Err(self.not_finite(&place, phase, step));
        }
        Ok((State { network: taken.network, optimizer, place }, step))
    }

    /// What the network achieves on the examples held out; none if it was stopped meanwhile.
    fn validated(&self, network: &Network) -> Result<Option<Metrics>> {
        let network = network.valid();
        let mut outputs = Vec::new();
        let batches = self.split.validation.chunks(self.run.config.optimizer.batch);
        batch::ahead(self.examples, batches, |batches| {
            for batch in batches {
                if self.run.stop.load(Ordering::Relaxed) {
                    return Ok(None);
                }
                let output = network.forward(batch?.images(&self.run.device.clone().inner()));
                outputs.extend(output.into_data().iter::<f32>());
            }
            Ok(Some(self.targets.metrics(&self.split.validation, &outputs)))
        })
    }

    /// Closes an epoch: record, best, last, in this order, so that a crash between them repeats what is missing.
    fn completed(
        &self,
        mut state: State,
        phase: &Phase,
        validation: Metrics,
        journal: &mut Journal,
    ) -> Result<State> {
        let place = &mut state.place;
        let learning_rate = phase.rate(place.phase_steps(phase) - 1);
        if !validation.loss().is_finite() {
            let step = Step { loss: validation.loss(), learning_rate, gradient_norm: place.gradient_norm };
            return Err(self.not_finite(place, phase, step));
        }
        let record = EpochRecord {
            epoch: place.epoch + 1,
            phase: place.phase + 1,
            steps: place.steps,
            learning_rate,
            training_loss: place.loss_sum / phase.batches as f64,
            gradient_norm: place.gradient_norm,
            validation,
        };
        journal.complete_epoch(&record)?;
        if place.complete(record, phase) {
            self.contents(&state).save(&self.best())?;
        }
        self.save_last(&state)?;
        Ok(state)
    }

    fn contents<'a>(&'a self, state: &'a State) -> Contents<'a> {
        let Run { config, device_name, program, .. } = *self.run;
        let Origin { pretrained_sha256, parent } = &self.origin;
        let info = ModelInfo {
            seed: config.seed,
            pretrained_sha256: pretrained_sha256.clone(),
            parent: parent.clone(),
            device: Some(device_name.to_owned()),
            program: program.cloned(),
            epoch: state.place.last.clone(),
            ..ModelInfo::new(&self.task, self.examples, self.targets.standardization())
        };
        Contents { info, config, network: &state.network, training: None }
    }

    fn save_last(&self, state: &State) -> Result<()> {
        let training = Some(Resumption { optimizer: &state.optimizer, place: &state.place });
        Contents { training, ..self.contents(state) }.save(&self.last())
    }

    fn interrupted(&self, state: &State) -> Error {
        let [_, epochs] = state.place.planned(&self.phases);
        match self.save_last(state) {
            Ok(()) => Error::Interrupted { epoch: state.place.epoch + 1, epochs, checkpoint: self.last() },
            Err(error) => error,
        }
    }

    fn not_finite(&self, place: &Place, phase: &Phase, step: Step) -> Error {
        Error::NotFinite {
            phase: place.phase,
            epoch: place.epoch + 1,
            batch: (place.batch + 1).min(phase.batches),
            learning_rate: step.learning_rate,
            loss: step.loss,
            gradient_norm: step.gradient_norm,
            checkpoint: Some(self.last()).filter(|last| last.exists()),
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::fs;

    use datagen::Kind;

    use super::*;
    use crate::config::tests::{phase, tiny};
    use crate::config::{ImageSource, PhaseConfig};
    use crate::examples::tests::{dataset, squares, two_datasets};
    use crate::history;

    /// A run from its start, for which the clock stands still.
    pub(crate) fn still<'a>(
        config: &'a TrainConfig,
        directory: &'a Path,
        device: &'a Device,
        stop: &'a AtomicBool,
    ) -> Run<'a> {
        Run {
            config,
            directory,
            device,
            device_name: "CPU",
            program: None,
            warm_start: None,
            resume: false,
            stop,
            gauge: &Gauge::default,
        }
    }

    /// Runs a configuration in a directory, and stops it before step `stop_at`, counted from the start of this call.
    fn run(config: &TrainConfig, directory: &Path, resume: bool, stop_at: Option<usize>) -> Result<Fitted> {
        let (device, stop) = (Device::flex(), AtomicBool::new(stop_at == Some(0)));
        let examples = squares(&config.task()?, 32);
        let mut steps = 0;
        let run = Run { resume, ..still(config, directory, &device, &stop) };
        fit(&run, &examples, &mut |progress| {
            steps += usize::from(matches!(progress, Progress::Step { .. }));
            stop.store(Some(steps) == stop_at, Ordering::Relaxed);
        })
    }

    /// Digests of what a run leaves.
    pub(crate) fn left(directory: &Path) -> [String; 5] {
        let optimizer = "last/optimizer.safetensors";
        ["last/weights.safetensors", optimizer, "last/model.json", "best/model.json", "metrics.jsonl"]
            .map(|name| datagen::digest::digest(&fs::read(directory.join(name)).unwrap()))
    }

    #[test]
    fn the_loss_falls_on_both_tasks() {
        for kind in [Kind::Approach, Kind::Avoidance] {
            let directory = tempfile::tempdir().unwrap();
            let mut config = tiny(kind);
            config.phases = vec![phase(20)];
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
        config.phases = vec![phase(2)];
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
    fn streamed_and_cached_images_give_the_same_weights() {
        let [a, b] = ["a", "b"].map(|name| dataset(name, 60.0));
        let datasets = vec![a.path().to_owned(), b.path().to_owned()];
        let (device, stop) = (Device::flex(), AtomicBool::new(false));
        let [streamed, cached] = [ImageSource::Stream, ImageSource::Cache].map(|images| {
            let mut config = TrainConfig { images, datasets: datasets.clone(), ..tiny(Kind::Approach) };
            config.optimizer.batch = 2;
            let directory = tempfile::tempdir().unwrap();
            let examples =
                Examples::load(&config.task().unwrap(), images, &config.datasets, &|_, _| ()).unwrap();
            let mut losses = Vec::new();
            let run = still(&config, directory.path(), &device, &stop);
            let fitted = fit(&run, &examples, &mut |progress| {
                if let Progress::Step { loss, .. } = progress {
                    losses.push(loss.to_bits());
                }
            });
            (losses, fitted.unwrap().last, left(directory.path()))
        });
        // Three steps an epoch.
        assert_eq!(streamed.0.len(), 12);
        assert_eq!(streamed, cached);
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
        config.phases = vec![phase(1)];
        let nothing = run(&config, directory.path(), true, None).unwrap_err();
        assert!(matches!(nothing, Error::NothingToResume { .. }));
        run(&config, directory.path(), false, None).unwrap();
        assert!(matches!(run(&config, directory.path(), false, None), Err(Error::RunExists { .. })));
        config.phases[0].learning_rate = 0.01;
        let other = run(&config, directory.path(), true, None).unwrap_err();
        assert!(matches!(&other, Error::OtherRun { key, .. } if key == "phases.0.learning_rate"), "{other}");
        config.phases = vec![phase(1)];
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
        config.phases = vec![PhaseConfig { learning_rate: 1.0, warmup: 0.0, ..phase(400) }];
        let error = run(&config, directory.path(), false, None).unwrap_err();
        assert!(matches!(error, Error::NotFinite { .. }), "{error}");
        assert!(error.to_string().contains("phases.0.learning_rate"), "{error}");
    }

    #[test]
    fn phases_take_their_ratio_and_end_with_their_patience() {
        let directories: [_; 2] = std::array::from_fn(|_| tempfile::tempdir().unwrap());
        let mut config = tiny(Kind::Approach);
        config.datasets = vec!["a".into(), "b".into()];
        // Nothing is learned at such a rate: the second epoch and the third are in vain.
        let idle = PhaseConfig { learning_rate: 1e-30, patience: Some(2), ..phase(10) };
        config.phases = vec![idle, PhaseConfig { ratio: Some(vec![1, 0]), ..phase(2) }];
        let task = config.task().unwrap();
        let examples = two_datasets(&task, [32, 16]);
        let (device, stop) = (Device::flex(), AtomicBool::new(false));
        let mut planned = Vec::new();
        let mut fit_in = |directory: &Path, resume, stop_at| {
            stop.store(false, Ordering::Relaxed);
            let run = Run { resume, ..still(&config, directory, &device, &stop) };
            fit(&run, &examples, &mut |progress| {
                if let Progress::Step { step, .. } = progress {
                    stop.store(Some(step[0]) == stop_at, Ordering::Relaxed);
                    planned.push(step);
                }
            })
        };
        let whole = directories[0].path();
        let fitted = fit_in(whole, false, None).unwrap();
        // 24 and 12 training examples are 9 steps an epoch, 24 alone are 6.
        let epochs: Vec<_> = history::read(whole).unwrap().iter().map(|e| (e.phase, e.steps)).collect();
        assert_eq!(epochs, [(1, 9), (1, 18), (1, 27), (2, 33), (2, 39)]);
        assert_eq!(fitted.last.epoch, 5);
        // Stopped within the epoch that decides about the phase, and in the second phase.
        fit_in(directories[1].path(), false, Some(22)).unwrap_err();
        fit_in(directories[1].path(), true, Some(31)).unwrap_err();
        fit_in(directories[1].path(), true, None).unwrap();
        assert_eq!(left(whole), left(directories[1].path()));
        assert_eq!((planned[0], planned[38]), ([1, 10 * 9 + 2 * 6], [39, 39]));
    }

    #[test]
    fn what_is_resumed_must_be_the_same_data() {
        let directory = tempfile::tempdir().unwrap();
        let config = TrainConfig { phases: vec![phase(1)], ..tiny(Kind::Approach) };
        let task = config.task().unwrap();
        let (device, stop) = (Device::flex(), AtomicBool::new(false));
        fit(&still(&config, directory.path(), &device, &stop), &squares(&task, 32), &mut |_| ()).unwrap();
        let resumed = |config: &TrainConfig, examples: &Examples, device_name| {
            let run = still(config, directory.path(), &device, &stop);
            let mut other = None;
            let fitted = fit(&Run { resume: true, device_name, ..run }, examples, &mut |progress| {
                if let Progress::Begun { other_device, .. } = progress {
                    other = other_device;
                }
            });
            fitted.map(|_| other).map_err(|error| error.to_string())
        };
        let digest = resumed(&config, &squares(&task, 36), "CPU").unwrap_err();
        assert!(
            digest.contains("datasets = squares (digest 32)") && digest.contains("squares (digest 36)"),
            "{digest}"
        );
        let camera = resumed(&config, &squares(&task, 32).seen_at(75.0), "CPU").unwrap_err();
        assert!(camera.contains("camera.horizontal_fov_deg = 60, and now it is 75"), "{camera}");
        let mut other = config.clone();
        other.network.label = Some(world::LabelForm::Difference);
        let label = resumed(&other, &squares(&task, 32), "CPU").unwrap_err();
        assert!(label.contains("network.label = \"twist\", and now it is \"difference\""), "{label}");
        // Another device is no reason to refuse, but to say so.
        assert_eq!(resumed(&config, &squares(&task, 32), "CPU"), Ok(None));
        assert_eq!(resumed(&config, &squares(&task, 32), "GPU"), Ok(Some("CPU".to_owned())));
        // Nor is it that a checkpoint does not say where it was computed, as those of older versions.
        let model = directory.path().join("last/model.json");
        let text = fs::read_to_string(&model).unwrap();
        fs::write(&model, text.replace("  \"device\": \"CPU\",\n", "")).unwrap();
        assert_eq!(ModelInfo::read(&directory.path().join("last")).unwrap().device, None);
        assert_eq!(resumed(&config, &squares(&task, 32), "GPU"), Ok(None));
    }

    #[test]
    fn a_line_of_metrics_says_it_all() {
        let directory = tempfile::tempdir().unwrap();
        let config = TrainConfig { phases: vec![phase(1)], ..tiny(Kind::Approach) };
        let (device, stop) = (Device::flex(), AtomicBool::new(false));
        let seconds = std::cell::Cell::new(0.0);
        let gauge = || {
            seconds.set(seconds.get() + 0.5);
            Gauge { seconds: seconds.get(), unix_time: 1.5e9, peak_memory_mb: Some(123.0) }
        };
        let run = Run { gauge: &gauge, ..still(&config, directory.path(), &device, &stop) };
        fit(&run, &squares(&config.task().unwrap(), 32), &mut |_| ()).unwrap();
        let text = fs::read_to_string(directory.path().join("metrics.jsonl")).unwrap();
        let line: serde_json::Value = serde_json::from_str(&text).unwrap();
        let axes =
            ["x_mm", "y_mm", "z_mm", "phi_deg", "theta_deg", "psi_deg"].map(|axis| format!("error_{axis}"));
        let further = [
            "validation_loss",
            "position_error_mm",
            "orientation_error_deg",
            "training_loss",
            "learning_rate",
        ];
        for key in axes.iter().map(String::as_str).chain(further) {
            assert!(line[key].is_f64(), "{key} in {text}");
        }
        // Six steps of four examples, each half a second of this clock.
        assert_eq!([&line["samples_per_s"], &line["peak_memory_mb"], &line["seconds"]], [8.0, 123.0, 4.0]);
        assert_eq!([&line["epoch"], &line["phase"], &line["steps"]], [1, 1, 6]);
        let model = fs::read_to_string(directory.path().join("best/model.json")).unwrap();
        assert!(!model.contains("samples_per_s"), "checkpoints say what is the same in every run");
    }

    #[test]
    fn too_few_examples_are_refused() {
        let directory = tempfile::tempdir().unwrap();
        let config = tiny(Kind::Approach);
        let (device, stop) = (Device::flex(), AtomicBool::new(false));
        let run = still(&config, directory.path(), &device, &stop);
        let error = fit(&run, &squares(&config.task().unwrap(), 1), &mut |_| ()).unwrap_err();
        assert!(matches!(error, Error::TooFewExamples { found: 1, needed: 2 }), "{error}");
    }
}
