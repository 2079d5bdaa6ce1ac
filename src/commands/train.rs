//! `flowservo train`: one network from its configuration and its datasets.

use super::{print_json, write_file};
use crate::cli;
use crate::config::Config;
use crate::device::{self, Opened};
use crate::progress::{Progress, peak_rss_mb};
use crate::stop::Stop;
use anyhow::{Context, Result};
use registry::{Digest, Lineage, Provenance};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use train::checkpoint::ModelInfo;
use train::config::TrainConfig;
use train::examples::Examples;
use train::fit::{self, EpochRecord, Run};
use train::metric::Metrics;
use train::pretrained::Imported;

/// Name of the file beside a run's checkpoints that says how the run went. It is written last.
pub(crate) const RESULT: &str = "result.json";

/// What a run achieved, and how fast.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Trained {
    /// Checkpoint of the best epoch.
    pub(crate) checkpoint: PathBuf,
    /// Where it was computed.
    pub(crate) device: String,
    /// Time that this run took, with reading the data.
    pub(crate) seconds: f64,
    /// Examples that this run learned from, counted once an epoch.
    pub(crate) samples: usize,
    /// Examples a second, without reading the data.
    pub(crate) samples_per_s: f64,
    /// Largest memory of the process.
    pub(crate) peak_rss_mb: Option<f64>,
    /// On the validation set at the best epoch: the paper's norm; none for `CNN_avoid`.
    pub(crate) position_error_mm: Option<f64>,
    /// See `position_error_mm`.
    pub(crate) orientation_error_deg: Option<f64>,
    /// The best epoch.
    pub(crate) best: EpochRecord,
    /// Mean loss of successive groups of batches of this run, at the epoch's fraction at which the group ends.
    pub(crate) losses: Vec<[f64; 2]>,
}

/// Runs the command.
pub(crate) fn run(arguments: &cli::Train, stop: &Stop, json: bool) -> Result<()> {
    let file = Config::load(&arguments.config.config, &arguments.config.overrides)?;
    let mut config: TrainConfig = file.parse()?;
    if !arguments.data.is_empty() {
        config.datasets.clone_from(&arguments.data);
    }
    file.check(config.task())?;
    let device = device::open(arguments.device)?;
    let job = Job {
        name: "training",
        config: &config,
        out: &arguments.out,
        device: &device,
        resume: arguments.resume,
    };
    let trained = fit(&job, stop)?;
    println!("{}: {}", trained.checkpoint.display(), in_words(&trained.best.validation));
    print_json(json, &trained)
}

/// A network to train.
pub(crate) struct Job<'a> {
    /// How the work is called in front of people.
    pub(crate) name: &'a str,
    /// What is done.
    pub(crate) config: &'a TrainConfig,
    /// Folder of the run.
    pub(crate) out: &'a Path,
    /// Where it is computed.
    pub(crate) device: &'a Opened,
    /// Continue the run in the folder.
    pub(crate) resume: bool,
}

/// Trains a network in a folder and shows how it goes.
pub(crate) fn fit(job: &Job, stop: &Stop) -> Result<Trained> {
    let Job { name, config, out, device, resume } = *job;
    let task = config.task()?;
    let loading = Progress::start(&format!("{name}: reading"), "examples", 0);
    let examples =
        Examples::load(&task, &config.datasets, &|done, total| loading.update_of(done as u64, total as u64))?;
    let reading_seconds = loading.finish();
    let total = config.optimizer.epochs * examples.len();
    let progress = Progress::start(name, "examples", total as u64);
    progress.say(&format!("{name}: {} examples, on {}", examples.len(), device.name));
    let run = Run { config, directory: out, device: &device.device, resume, stop: stop.flag() };
    let mut samples = 0;
    let mut losses = LossCurve::default();
    let fitted = fit::fit(&run, &examples, &mut |news| match news {
        fit::Progress::Step { epoch: [epoch, epochs], batch: [batch, batches], examples: step, loss } => {
            samples += step;
            let done = (epoch - 1) as f64 + batch as f64 / batches as f64;
            losses.add(loss, done, (epochs * batches).div_ceil(LossCurve::GROUPS));
            progress.update(
                (done / epochs as f64 * total as f64) as u64,
                &format!("epoch {epoch}/{epochs}, loss {loss:.4}"),
            );
        }
        fit::Progress::Imported(imported) => {
            for line in report(imported) {
                progress.say(&format!("{name}: {line}"));
            }
        }
        fit::Progress::Epoch(record) => progress.say(&format!(
            "{name}: epoch {}, training loss {:.4}, validation {}",
            record.epoch,
            record.training_loss,
            in_words(&record.validation)
        )),
    })?;
    let seconds = progress.finish();
    let (position_error_mm, orientation_error_deg) = match &fitted.best.validation {
        Metrics::Approach(metrics) => (Some(metrics.position_error_mm), Some(metrics.orientation_error_deg)),
        Metrics::Avoidance(_) => (None, None),
    };
    let trained = Trained {
        checkpoint: fitted.checkpoint,
        device: device.name.clone(),
        seconds: seconds + reading_seconds,
        samples,
        samples_per_s: samples as f64 / seconds.max(1e-9),
        peak_rss_mb: peak_rss_mb(),
        position_error_mm,
        orientation_error_deg,
        best: fitted.best,
        losses: losses.points,
    };
    write_file(&out.join(RESULT), serde_json::to_string_pretty(&trained)?)?;
    Ok(trained)
}

/// What became of a file of published weights, a line each.
fn report(imported: &Imported) -> Vec<String> {
    let Imported { path, matched, kept, unused, other_shape, .. } = imported;
    let parameters = matched.len() + kept.len() + other_shape.len();
    let mut lines =
        vec![format!("{} of {parameters} parameters begin from {}", matched.len(), path.display())];
    let mut list = |what: &str, names: &[String]| {
        if !names.is_empty() {
            lines.push(format!("  {what}: {}", names.join(", ")));
        }
    };
    list("not in the file, initial weights", kept);
    let shapes = other_shape.iter();
    let shapes =
        shapes.map(|other| format!("{} {:?} (there {:?})", other.parameter, other.ours, other.theirs));
    list("other shape, initial weights", &shapes.collect::<Vec<_>>());
    list("in the file, but not used", unused);
    lines
}

/// The losses of a run, averaged over groups of batches.
#[derive(Default)]
struct LossCurve {
    points: Vec<[f64; 2]>,
    sum: f64,
    batches: usize,
}

impl LossCurve {
    /// About so many groups a run.
    const GROUPS: usize = 100;

    /// One more batch, after which `epoch` epochs are done; `group` batches make a group.
    fn add(&mut self, loss: f64, epoch: f64, group: usize) {
        self.sum += loss;
        self.batches += 1;
        if self.batches == group {
            self.points.push([epoch, self.sum / group as f64]);
            (self.sum, self.batches) = (0.0, 0);
        }
    }
}

/// Validation metrics in a few words.
pub(crate) fn in_words(metrics: &Metrics) -> String {
    match metrics {
        Metrics::Approach(m) => format!(
            "loss {:.4}, {:.2} mm, {:.2} degrees",
            m.loss, m.position_error_mm, m.orientation_error_deg
        ),
        Metrics::Avoidance(m) => {
            format!("loss {:.4}, RMS error {:.3}, skill {:.2}", m.loss, m.rms_error, m.skill)
        }
    }
}

/// Where a checkpoint comes from and how good it is, for the registry.
pub(crate) fn provenance(checkpoint: &Path) -> Result<Provenance> {
    let path = checkpoint.join("model.json");
    let text = std::fs::read_to_string(&path)
        .with_context(|| format!("{}: cannot be read; is this a checkpoint's folder?", path.display()))?;
    let info: ModelInfo = serde_json::from_str(&text).with_context(|| path.display().to_string())?;
    let mut datasets = BTreeMap::new();
    for source in &info.datasets {
        datasets.insert(source.name.clone(), format!("sha256:{}", source.digest).parse()?);
    }
    let config = std::fs::read(checkpoint.join("config.toml"))?;
    let software = BTreeMap::from([("flowservo".to_owned(), env!("CARGO_PKG_VERSION").to_owned())]);
    // The run's own folder, if the checkpoint still lies in it, knows the device.
    let result = checkpoint.parent().and_then(|run| std::fs::read_to_string(run.join(RESULT)).ok());
    let result: Option<Trained> = result.and_then(|text| serde_json::from_str(&text).ok());
    let lineage = Lineage {
        datasets,
        config: Some(Digest::of(&config)),
        parent: None,
        code_revision: option_env!("FLOWSERVO_REVISION").map(str::to_owned),
        seed: Some(info.seed),
        device: result.map(|trained| trained.device),
        software,
    };
    let metrics = info.epoch.as_ref().map(|epoch| metrics(&epoch.validation)).unwrap_or_default();
    Ok(Provenance { lineage, metrics, created: None })
}

fn metrics(validation: &Metrics) -> BTreeMap<String, f64> {
    let named = match validation {
        Metrics::Approach(m) => vec![
            ("validation_loss", m.loss),
            ("validation_position_error_mm", m.position_error_mm),
            ("validation_orientation_error_deg", m.orientation_error_deg),
        ],
        Metrics::Avoidance(m) => {
            vec![
                ("validation_loss", m.loss),
                ("validation_rms_error", m.rms_error),
                ("validation_skill", m.skill),
            ]
        }
    };
    named.into_iter().map(|(name, value)| (name.to_owned(), value)).collect()
}
