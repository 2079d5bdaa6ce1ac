//! The training loop: phases, and the epochs of each phase.
//!
//! Everything it computes is a function of the configuration, the examples and the training state. A run that was stopped
//! or killed at any moment therefore resumes to the same weights, bit-identical on the CPU.

use std::fs;
use std::path::PathBuf;

use super::epoch::Training;
use super::event::Event;
use super::learner::Learner;
use super::run::Run;
use super::start::Start;
use crate::checkpoint::files::write_config;
use crate::checkpoint::training_state::TrainingState;
use crate::data::examples::Examples;
use crate::data::split::Split;
use crate::data::targets::Targets;
use crate::error::{Result, at};
use crate::metrics::history::EpochRecord;
use crate::metrics::journal::Journal;
use crate::optimizer::phase::Phase;

/// Summary of a complete run.
#[derive(Debug)]
pub struct RunSummary {
    /// Checkpoint of the best epoch.
    pub checkpoint: PathBuf,
    /// The best epoch.
    pub best: EpochRecord,
    /// The last epoch.
    pub last: EpochRecord,
    /// Training loss: the end of each group of batches, in epochs since the start of the run, and its mean loss.
    pub losses: Vec<[f64; 2]>,
}

/// Trains a network from the start, or resumes a run.
///
/// # Panics
/// If a new run has a [`warm_start`](Run::warm_start) but its configuration no `parent`, or vice versa.
pub fn fit(run: &Run, examples: &Examples, report: &mut dyn FnMut(Event)) -> Result<RunSummary> {
    let config = run.config;
    let task = config.task()?;
    let split = Split::new(config.seed, config.validation, &examples.ranges());
    let plan = |phase| Phase::new(phase, config.optimizer.batch, &split);
    let phases = config.phases.iter().map(plan).collect::<Result<Vec<_>>>()?;
    let start = if run.resume {
        Start::resume(run, examples)?
    } else {
        Start::new_run(run, &task, examples, report)?
    };
    let Start { mut learner, standardization, initial_weights, other_device } = start;
    let targets = Targets::new(&task, examples, &split.all_training(), standardization)?;
    if !run.resume {
        fs::create_dir_all(run.directory).map_err(at(run.directory))?;
        write_config(run.directory, config)?;
    }
    let training = Training { run, task, examples, split, targets, phases, initial_weights };
    let TrainingState { epoch: epochs, steps, .. } = learner.state;
    let [planned, _] = learner.state.planned(&training.phases);
    report(Event::Started { epochs, steps, planned, other_device });
    let mut journal = Journal::open(run.directory, run.telemetry, epochs, steps)?;
    while let Some(phase) = training.phases.get(learner.state.phase) {
        learner = training.epoch(learner, phase, &mut journal, report)?;
        if let Some(record) = &learner.state.last {
            report(Event::Epoch(record));
        }
    }
    let Learner { state: TrainingState { best: Some(best), last: Some(last), losses, .. }, .. } = learner
    else {
        unreachable!("a configuration has at least one epoch");
    };
    Ok(RunSummary { checkpoint: run.best(), best, last, losses: losses.points })
}

#[cfg(test)]
pub(crate) mod tests {
    use std::path::Path;
    use std::sync::atomic::{AtomicBool, Ordering};

    use burn::tensor::Device;
    use datagen::Kind;

    use super::*;
    use crate::checkpoint::model_info::ModelInfo;
    use crate::config::tests::{phase, tiny};
    use crate::config::{ImageSource, PhaseConfig, TrainConfig};
    use crate::data::examples::tests::{dataset, squares, two_datasets};
    use crate::error::Error;
    use crate::metrics::{Telemetry, history};

    /// Returns a new run with a clock that stands still.
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
            telemetry: &Telemetry::default,
        }
    }

    /// Runs a configuration in a folder. Stops before step `stop_at`, counted from the start of this call.
    fn run(
        config: &TrainConfig,
        directory: &Path,
        resume: bool,
        stop_at: Option<usize>,
    ) -> Result<RunSummary> {
        let (device, stop) = (Device::flex(), AtomicBool::new(stop_at == Some(0)));
        let examples = squares(&config.task()?, 32);
        let mut steps = 0;
        let run = Run { resume, ..still(config, directory, &device, &stop) };
        fit(&run, &examples, &mut |event| {
            steps += usize::from(matches!(event, Event::Step { .. }));
            stop.store(Some(steps) == stop_at, Ordering::Relaxed);
        })
    }

    /// Returns the digests of a run's files.
    pub(crate) fn digests(directory: &Path) -> [String; 5] {
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
        let [a, b, c] = directories.each_ref().map(|directory| digests(directory.path()));
        assert_eq!(a, b);
        assert_ne!(a[0], c[0]);
    }

    #[test]
    fn a_run_stopped_anywhere_ends_like_an_uninterrupted_one() {
        let whole = tempfile::tempdir().unwrap();
        let config = tiny(Kind::Approach);
        run(&config, whole.path(), false, None).unwrap();
        // 24 training examples are 6 steps per epoch. Stops within an epoch, between two, and before the first step.
        for stops in [vec![3], vec![12], vec![0, 5, 7]] {
            let parts = tempfile::tempdir().unwrap();
            for (i, &stop) in stops.iter().enumerate() {
                let error = run(&config, parts.path(), i > 0, Some(stop)).unwrap_err();
                assert!(matches!(error, Error::Interrupted { .. }), "{error}");
            }
            run(&config, parts.path(), true, None).unwrap();
            assert_eq!(digests(whole.path()), digests(parts.path()), "{stops:?}");
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
            let fitted = fit(&run, &examples, &mut |event| {
                if let Event::Step { loss, .. } = event {
                    losses.push(loss.to_bits());
                }
            });
            (losses, fitted.unwrap().last, digests(directory.path()))
        });
        // Three steps per epoch.
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
        assert_eq!(digests(whole.path()), digests(killed.path()));
        // A complete run has nothing to do.
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
        // A learning rate of 1 makes the network diverge.
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
        // Nothing is learned at this rate, so the second and third epochs bring no improvement.
        let idle = PhaseConfig { learning_rate: 1e-30, patience: Some(2), ..phase(10) };
        config.phases = vec![idle, PhaseConfig { ratio: Some(vec![1, 0]), ..phase(2) }];
        let task = config.task().unwrap();
        let examples = two_datasets(&task, [32, 16]);
        let (device, stop) = (Device::flex(), AtomicBool::new(false));
        let mut planned = Vec::new();
        let mut fit_in = |directory: &Path, resume, stop_at| {
            stop.store(false, Ordering::Relaxed);
            let run = Run { resume, ..still(&config, directory, &device, &stop) };
            fit(&run, &examples, &mut |event| {
                if let Event::Step { step, .. } = event {
                    stop.store(Some(step[0]) == stop_at, Ordering::Relaxed);
                    planned.push(step);
                }
            })
        };
        let whole = directories[0].path();
        let fitted = fit_in(whole, false, None).unwrap();
        // 24 and 12 training examples are 9 steps per epoch, 24 alone are 6.
        let epochs: Vec<_> = history::read(whole).unwrap().iter().map(|e| (e.phase, e.steps)).collect();
        assert_eq!(epochs, [(1, 9), (1, 18), (1, 27), (2, 33), (2, 39)]);
        assert_eq!(fitted.last.epoch, 5);
        // Stopped within the epoch that ends the phase, and in the second phase.
        fit_in(directories[1].path(), false, Some(22)).unwrap_err();
        fit_in(directories[1].path(), true, Some(31)).unwrap_err();
        fit_in(directories[1].path(), true, None).unwrap();
        assert_eq!(digests(whole), digests(directories[1].path()));
        assert_eq!((planned[0], planned[38]), ([1, 10 * 9 + 2 * 6], [39, 39]));
    }

    #[test]
    fn a_resumed_run_needs_the_same_data() {
        let directory = tempfile::tempdir().unwrap();
        let config = TrainConfig { phases: vec![phase(1)], ..tiny(Kind::Approach) };
        let task = config.task().unwrap();
        let (device, stop) = (Device::flex(), AtomicBool::new(false));
        fit(&still(&config, directory.path(), &device, &stop), &squares(&task, 32), &mut |_| ()).unwrap();
        let resumed = |config: &TrainConfig, examples: &Examples, device_name| {
            let run = still(config, directory.path(), &device, &stop);
            let mut other = None;
            let fitted = fit(&Run { resume: true, device_name, ..run }, examples, &mut |event| {
                if let Event::Started { other_device, .. } = event {
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
        assert!(camera.contains("camera.horizontal_fov_deg = 60, but now it is 75"), "{camera}");
        let mut other = config.clone();
        other.network.label = Some(world::LabelForm::Difference);
        let label = resumed(&other, &squares(&task, 32), "CPU").unwrap_err();
        assert!(label.contains("network.label = \"twist\", but now it is \"difference\""), "{label}");
        // A different device is accepted and reported.
        assert_eq!(resumed(&config, &squares(&task, 32), "CPU"), Ok(None));
        assert_eq!(resumed(&config, &squares(&task, 32), "GPU"), Ok(Some("CPU".to_owned())));
        // So are older checkpoints, which do not record the device.
        let model = directory.path().join("last/model.json");
        let text = fs::read_to_string(&model).unwrap();
        fs::write(&model, text.replace("  \"device\": \"CPU\",\n", "")).unwrap();
        assert_eq!(ModelInfo::read(&directory.path().join("last")).unwrap().device, None);
        assert_eq!(resumed(&config, &squares(&task, 32), "GPU"), Ok(None));
    }

    #[test]
    fn a_line_of_metrics_is_complete() {
        let directory = tempfile::tempdir().unwrap();
        let config = TrainConfig { phases: vec![phase(1)], ..tiny(Kind::Approach) };
        let (device, stop) = (Device::flex(), AtomicBool::new(false));
        let seconds = std::cell::Cell::new(0.0);
        let telemetry = || {
            seconds.set(seconds.get() + 0.5);
            Telemetry { seconds: seconds.get(), unix_time: 1.5e9, peak_memory_mb: Some(123.0) }
        };
        let run = Run { telemetry: &telemetry, ..still(&config, directory.path(), &device, &stop) };
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
        // Six steps of four examples, half a second each.
        assert_eq!([&line["samples_per_s"], &line["peak_memory_mb"], &line["seconds"]], [8.0, 123.0, 4.0]);
        assert_eq!([&line["epoch"], &line["phase"], &line["steps"]], [1, 1, 6]);
        let model = fs::read_to_string(directory.path().join("best/model.json")).unwrap();
        assert!(!model.contains("samples_per_s"), "checkpoints hold only what is the same in every run");
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
