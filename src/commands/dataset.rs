//! `flowservo dataset`: make datasets and look into them.

use super::{inspect, replay};
use crate::cli;
use crate::config::Config;
use crate::memory::peak_rss_mb;
use crate::output::{out, print_json};
use crate::progress::Progress;
use crate::stop::Stop;
use anyhow::Result;
use datagen::finish::Finished;
use datagen::shard::Shard;
use datagen::{DatasetConfig, DatasetInfo, Options, Part};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::Path;

/// What `dataset generate` made, and how fast.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Generated {
    /// Name of the dataset.
    pub(crate) name: String,
    /// Rows of the dataset.
    pub(crate) rows: u64,
    /// Images of the dataset.
    pub(crate) images: u64,
    /// Rows made by this run.
    pub(crate) rows_made: u64,
    /// Time that this run took.
    pub(crate) seconds: f64,
    /// Images that this run made in a second.
    pub(crate) images_per_s: f64,
    /// Largest memory of the process.
    pub(crate) peak_rss_mb: Option<f64>,
    /// Digest of the dataset.
    pub(crate) digest: String,
}

/// Runs one of the commands.
pub(crate) fn run(command: &cli::Dataset, stop: &Stop, json: bool) -> Result<()> {
    match command {
        cli::Dataset::Generate { config, out, shard } => {
            let file = Config::load(&config.config, &config.overrides)?;
            let config: DatasetConfig = file.parse()?;
            file.check(config.validate())?;
            if let Some(part) = shard {
                let generated = generate_part(&config, *part, out, stop)?;
                return print_json(json, &generated);
            }
            let generated = generate(&config, out, stop)?;
            out!(
                "{}: {} rows, {} images, digest {}",
                out.display(),
                generated.rows,
                generated.images,
                generated.digest
            );
            print_json(json, &generated)
        }
        cli::Dataset::Finish { dataset } => finish(dataset, json),
        cli::Dataset::Info { dataset } => inspect::info(dataset, json),
        cli::Dataset::Show(arguments) => inspect::show(arguments, json),
        cli::Dataset::Verify { dataset } => verify(dataset, json),
        cli::Dataset::Replay { dataset, row, out } => replay::run(dataset, *row, out.as_deref(), json),
    }
}

/// Makes a dataset in a folder and shows how it goes.
pub(crate) fn generate(config: &DatasetConfig, out: &Path, stop: &Stop) -> Result<Generated> {
    let progress = Progress::start(&format!("dataset {}", config.name), "rows", config.count);
    let options = Options { stop: stop.flag() };
    let summary = datagen::generate(config, out, &options, &follow(&progress))?;
    say_found(&progress, out, [summary.rows, summary.rows_made]);
    let seconds = progress.finish();
    let images_made = summary.images as f64 / summary.rows as f64 * summary.rows_made as f64;
    Ok(Generated {
        name: config.name.clone(),
        rows: summary.rows,
        images: summary.images,
        rows_made: summary.rows_made,
        seconds,
        images_per_s: images_made / seconds.max(1e-9),
        peak_rss_mb: peak_rss_mb(),
        digest: summary.digest,
    })
}

/// Passes on how far a dataset is.
fn follow(progress: &Progress) -> impl Fn(datagen::Progress) {
    |state| progress.update_from(state.rows_done - state.rows_made, state.rows_done)
}

/// Says how many rows were there, if some but not all were.
fn say_found(progress: &Progress, out: &Path, [rows, made]: [u64; 2]) {
    if (1..rows).contains(&made) {
        progress.say(&format!("{}: {} rows were there already", out.display(), rows - made));
    }
}

/// What `dataset generate --shard` made.
#[derive(Debug, Serialize)]
struct GeneratedPart {
    name: String,
    shard: String,
    /// Files of the part, and their rows.
    files: u64,
    rows: u64,
    rows_made: u64,
    /// Files of the whole dataset, and how many of them are there now.
    files_of_dataset: u64,
    files_finished: u64,
    seconds: f64,
}

/// Makes a part of a dataset and says how to go on.
fn generate_part(config: &DatasetConfig, part: Part, out: &Path, stop: &Stop) -> Result<GeneratedPart> {
    let rows = Shard::of_part(config, part).iter().map(|shard| shard.rows.end - shard.rows.start).sum();
    let progress = Progress::start(&format!("dataset {}, part {part}", config.name), "rows", rows);
    let options = Options { stop: stop.flag() };
    let summary = datagen::generate_part(config, part, out, &options, &follow(&progress))?;
    say_found(&progress, out, [summary.rows, summary.rows_made]);
    let generated = GeneratedPart {
        name: config.name.clone(),
        shard: part.to_string(),
        files: summary.files,
        rows: summary.rows,
        rows_made: summary.rows_made,
        files_of_dataset: config.shards(),
        files_finished: datagen::record::finished(config, out)?,
        seconds: progress.finish(),
    };
    let GeneratedPart { files, rows, files_of_dataset, files_finished, .. } = &generated;
    let out = out.display();
    out!("{out}: part {part} is there: {files} files, {rows} rows");
    out!(
        "{files_finished} of {files_of_dataset} files are there; once all are, run: flowservo dataset finish {out}"
    );
    Ok(generated)
}

/// Completes a dataset that was made in parts.
fn finish(dataset: &Path, json: bool) -> Result<()> {
    let Finished { info, before } = datagen::finish(dataset)?;
    let (folder, done) = (dataset.display(), if before { "was finished before" } else { "finished" });
    out!(
        "{folder}: {done}: {} rows in {} files, {} images, digest {}",
        info.rows,
        info.files.len(),
        info.images,
        info.digest
    );
    let result = json!({
        "name": info.name, "rows": info.rows, "images": info.images, "files": info.files.len(), "digest": info.digest,
        "finished_before": before,
    });
    print_json(json, &result)
}

/// Compares a dataset with what was written.
fn verify(dataset: &Path, json: bool) -> Result<()> {
    let faults = datagen::verify(dataset)?;
    let listed: Vec<_> = faults
        .iter()
        .map(|fault| json!({ "path": fault.path, "problem": fault.problem.to_string() }))
        .collect();
    let info = DatasetInfo::read(dataset).ok();
    let files = info.as_ref().map(|info| info.files.len());
    let digest = info.as_ref().map(|info| &info.digest);
    if let (true, Some(files)) = (faults.is_empty(), files) {
        out!(
            "{}: {files} files with rows, card and configuration are as they were written",
            dataset.display()
        );
    }
    print_json(json, &json!({ "files": files, "digest": digest, "faults": listed }))?;
    Ok(datagen::fault::none(dataset, faults)?)
}
