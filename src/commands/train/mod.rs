//! `flowservo train`: trains a network on datasets.

mod warm_start;

use crate::cli;
use crate::config::Config;
use crate::device::{self, Opened};
use crate::file::write_file;
use crate::memory::peak_rss_mb;
use crate::output::{note, out, print_json};
use crate::progress::Progress;
use crate::stop::Stop;
use ::report::training_curves::{Epoch, TrainingCurve, training_curves};
use anyhow::Result;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::{Instant, SystemTime};
use train::checkpoint::{Imported, Program};
use train::metrics::history;
use train::{EpochRecord, Event, Examples, Metrics, Run, Telemetry, TrainConfig, WarmStart};

/// Name of the file with the result of a run, beside its checkpoints. It is written last.
pub(crate) const RESULT: &str = "result.json";
/// Name of the file with the learning curves.
const CURVES: &str = "curves.svg";

/// Result of a run.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Trained {
    /// Checkpoint of the best epoch.
    pub(crate) checkpoint: PathBuf,
    /// Device of the training.
    pub(crate) device: String,
    /// Duration of the run, including reading the data.
    pub(crate) seconds: f64,
    /// Examples used since the run was started or resumed, counted once per epoch.
    pub(crate) samples: usize,
    /// Examples per second, not counting the time to read the data.
    pub(crate) samples_per_s: f64,
    /// Peak memory of the process.
    pub(crate) peak_rss_mb: Option<f64>,
    /// Position error on the validation set at the best epoch (the paper's norm). `None` for `CNN_avoid`.
    pub(crate) position_error_mm: Option<f64>,
    /// Orientation error, likewise.
    pub(crate) orientation_error_deg: Option<f64>,
    /// The best epoch.
    pub(crate) best: EpochRecord,
    /// Training loss: the end of each group of batches, in epochs, and its mean loss.
    pub(crate) losses: Vec<[f64; 2]>,
}

/// Runs the command.
pub(crate) fn run(arguments: &cli::Train, stop: &Stop, json: bool) -> Result<()> {
    let file = Config::load(&arguments.config.config, &arguments.config.overrides)?;
    let mut config: TrainConfig = file.parse()?;
    if !arguments.data.is_empty() {
        config.datasets.clone_from(&arguments.data);
    }
    if arguments.from.is_some() {
        config.parent.clone_from(&arguments.from);
    }
    let task = file.check(config.task())?;
    let warm_start = if arguments.resume {
        warm_start::recall(&mut config, &arguments.out);
        None
    } else {
        warm_start::find(&mut config, &task, &arguments.registry.registry)?
    };
    let device = device::open(arguments.device)?;
    let job = Job {
        name: "training",
        config: &config,
        out: &arguments.out,
        device: &device,
        warm_start: warm_start.as_ref(),
        resume: arguments.resume,
    };
    let trained = fit(&job, stop)?;
    out!("best epoch     {}: {}", trained.best.epoch, in_words(&trained.best.validation));
    out!("checkpoint     {}", trained.checkpoint.display());
    out!("metrics        {}", arguments.out.join("metrics.jsonl").display());
    out!("curves         {}", arguments.out.join(CURVES).display());
    out!("TensorBoard    tensorboard --logdir {}", arguments.out.join("tensorboard").display());
    print_json(json, &trained)
}

/// A network to train.
pub(crate) struct Job<'a> {
    /// Display name of the run.
    pub(crate) name: &'a str,
    /// Configuration.
    pub(crate) config: &'a TrainConfig,
    /// Folder of the run.
    pub(crate) out: &'a Path,
    /// Device to train on.
    pub(crate) device: &'a Opened,
    /// The model that a new run starts from.
    pub(crate) warm_start: Option<&'a WarmStart>,
    /// Whether to resume the run in the folder.
    pub(crate) resume: bool,
}

/// Trains a network in a folder and shows the progress.
pub(crate) fn fit(job: &Job, stop: &Stop) -> Result<Trained> {
    let Job { name, config, out, device, warm_start, resume } = *job;
    let task = config.task()?;
    let loading = Progress::start(&format!("{name}: reading"), "examples", 0);
    let examples = Examples::load(&task, config.images, &config.datasets, &|done, total| {
        loading.update_of(done as u64, total as u64, "");
    })?;
    let reading_seconds = loading.finish();
    for (dataset, cache) in config.datasets.iter().zip(examples.caches()) {
        if !cache.starts_with(dataset) {
            let (dataset, cache) = (dataset.display(), cache.display());
            note!("{name}: {dataset} is not writable; decoded images are in {cache}");
        }
    }
    let progress = Progress::start(name, "examples", 0);
    progress.say(&format!("{name}: {} examples, on {}", examples.len(), device.name));
    let (started, program) = (Instant::now(), program());
    let run = Run {
        config,
        directory: out,
        device: &device.device,
        device_name: &device.name,
        program: Some(&program),
        warm_start,
        resume,
        stop: stop.flag(),
        telemetry: &|| telemetry(started),
    };
    let mut display = Display {
        name,
        progress: &progress,
        batch: config.optimizer.batch,
        samples: 0,
        validation: String::new(),
    };
    let summary = train::fit(&run, &examples, &mut |event| display.show(event))?;
    let samples = display.samples;
    let seconds = progress.finish();
    let [position_error_mm, orientation_error_deg] = pose_errors(&summary.best.validation);
    let trained = Trained {
        checkpoint: summary.checkpoint,
        device: device.name.clone(),
        seconds: seconds + reading_seconds,
        samples,
        samples_per_s: samples as f64 / seconds.max(1e-9),
        peak_rss_mb: peak_rss_mb(),
        position_error_mm,
        orientation_error_deg,
        best: summary.best,
        losses: summary.losses,
    };
    let run_name = out.file_name().unwrap_or(out.as_os_str()).to_string_lossy();
    let drawn = training_curves(name, &[curve(&run_name, out, &trained)?]);
    write_file(&out.join(CURVES), drawn.svg)?;
    write_file(&out.join(RESULT), serde_json::to_string_pretty(&trained)?)?;
    Ok(trained)
}

/// Returns the version of this program.
fn program() -> Program {
    let software = [
        ("flowservo", Some(env!("CARGO_PKG_VERSION"))),
        ("burn", option_env!("FLOWSERVO_BURN")),
        ("rustc", option_env!("FLOWSERVO_RUSTC")),
    ];
    let known = |(name, version): (&str, Option<&str>)| Some((name.to_owned(), version?.to_owned()));
    Program {
        code_revision: option_env!("FLOWSERVO_REVISION").map(str::to_owned),
        software: software.into_iter().filter_map(known).collect(),
    }
}

/// Describes the import of published weights, line by line.
fn report(imported: &Imported) -> Vec<String> {
    let Imported { path, matched, kept, unused, other_shape, .. } = imported;
    let parameters = matched.len() + kept.len() + other_shape.len();
    let mut lines =
        vec![format!("{} of {parameters} parameters start from {}", matched.len(), path.display())];
    let mut list = |what: &str, names: &[String]| {
        if !names.is_empty() {
            lines.push(format!("  {what}: {}", names.join(", ")));
        }
    };
    list("not in the file, untrained", kept);
    let shapes = other_shape.iter();
    let shapes =
        shapes.map(|other| format!("{} {:?} (in the file {:?})", other.parameter, other.ours, other.theirs));
    list("different shape, untrained", &shapes.collect::<Vec<_>>());
    list("in the file, not used", unused);
    lines
}

/// Display of a run in progress.
struct Display<'a> {
    name: &'a str,
    progress: &'a Progress,
    batch: usize,
    /// Examples used so far.
    samples: usize,
    /// Result of the last validation.
    validation: String,
}

impl Display<'_> {
    fn show(&mut self, event: Event) {
        let Self { name, progress, batch, .. } = *self;
        match event {
            Event::Started { epochs, steps, planned, other_device } => {
                progress.begin_at((steps * batch) as u64, (planned * batch) as u64);
                if steps > 0 {
                    progress
                        .say(&format!("{name}: resumed after {epochs} epochs, at step {steps} of {planned}"));
                }
                if let Some(other) = other_device {
                    progress.say(&format!(
                        "{name}: previous steps ran on {other}; results on different devices agree, but are not bit-identical"
                    ));
                }
            }
            Event::Imported(imported) => {
                for line in report(imported) {
                    progress.say(&format!("{name}: {line}"));
                }
            }
            Event::WarmStart { parent, other_camera } => {
                progress.say(&format!("{name}: starts from {parent}"));
                if let Some((key, was, is)) = other_camera {
                    progress.say(&format!(
                        "{name}: {parent} was trained with {key} = {was}, but these images have {is}"
                    ));
                }
            }
            Event::Step { epoch: [epoch, epochs], step: [step, steps], examples, loss } => {
                self.samples += examples;
                let message = format!("epoch {epoch}/{epochs}, loss {loss:.4}{}", self.validation);
                progress.update_of((step * batch) as u64, (steps * batch) as u64, &message);
            }
            Event::Epoch(record) => {
                self.validation = format!(", validation {}", error_in_words(&record.validation));
                progress.say(&format!(
                    "{name}: epoch {}, training loss {:.4}, validation {}",
                    record.epoch,
                    record.training_loss,
                    in_words(&record.validation)
                ));
            }
        }
    }
}

/// Reads the clock and the memory.
#[expect(clippy::disallowed_methods, reason = "for the journal only, which affects no result")]
fn telemetry(started: Instant) -> Telemetry {
    let unix_time = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    Telemetry {
        seconds: started.elapsed().as_secs_f64(),
        unix_time: unix_time.as_secs_f64(),
        peak_memory_mb: peak_rss_mb(),
    }
}

/// Returns the learning curves of a run for plotting.
pub(crate) fn curve(name: &str, run: &Path, trained: &Trained) -> Result<TrainingCurve> {
    let epoch = |record: EpochRecord| {
        let [position_error_mm, orientation_error_deg] = pose_errors(&record.validation);
        Epoch {
            epoch: record.epoch,
            validation_loss: record.validation.loss(),
            position_error_mm,
            orientation_error_deg,
        }
    };
    let epochs = history::read(run)?.into_iter().map(epoch).collect();
    Ok(TrainingCurve { name: name.to_owned(), epochs, losses: trained.losses.clone() })
}

/// Returns position error in millimeters and orientation error in degrees. Both are `None` for `CNN_avoid`.
fn pose_errors(metrics: &Metrics) -> [Option<f64>; 2] {
    match metrics {
        Metrics::Approach(metrics) => [Some(metrics.position_error_mm), Some(metrics.orientation_error_deg)],
        Metrics::Avoidance(_) => [None, None],
    }
}

/// Formats the error without the loss.
fn error_in_words(metrics: &Metrics) -> String {
    match metrics {
        Metrics::Approach(m) => {
            format!("{:.2} mm, {:.2} degrees", m.position_error_mm, m.orientation_error_deg)
        }
        Metrics::Avoidance(m) => format!("RMS error {:.3}, skill {:.2}", m.rms_error, m.skill),
    }
}

/// Formats validation metrics.
pub(crate) fn in_words(metrics: &Metrics) -> String {
    format!("loss {:.4}, {}", metrics.loss(), error_in_words(metrics))
}
