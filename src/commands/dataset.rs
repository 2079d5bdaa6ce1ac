//! `flowservo dataset`: make datasets and look into them.

use super::{inspect, print_json, replay, write_file};
use crate::cli;
use crate::config::Config;
use crate::output::out;
use crate::progress::{Progress, peak_rss_mb};
use crate::stop::Stop;
use anyhow::Result;
use datagen::{DatasetConfig, DatasetInfo, Options};
use serde::{Deserialize, Serialize};
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
        cli::Dataset::Generate { config, out } => {
            let file = Config::load(&config.config, &config.overrides)?;
            let config: DatasetConfig = file.parse()?;
            file.check(config.validate())?;
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
        cli::Dataset::Info { dataset } => inspect::info(dataset, json),
        cli::Dataset::Show(arguments) => inspect::show(arguments, json),
        cli::Dataset::Verify { dataset } => {
            let info = DatasetInfo::read(dataset)?;
            info.verify(dataset)?;
            out!("{}: {} files are as they were written", dataset.display(), info.files.len());
            print_json(json, &serde_json::json!({ "files": info.files.len(), "digest": info.digest }))
        }
        cli::Dataset::Replay { dataset, row, out } => replay::run(dataset, *row, out.as_deref(), json),
    }
}

/// Makes a dataset in a folder and shows how it goes.
pub(crate) fn generate(config: &DatasetConfig, out: &Path, stop: &Stop) -> Result<Generated> {
    let progress = Progress::start(&format!("dataset {}", config.name), "rows", config.count);
    let summary =
        datagen::generate(config, out, &Options { stop: stop.flag() }, &|state: datagen::Progress| {
            progress.update_from(state.rows_done - state.rows_made, state.rows_done);
        })?;
    if (1..summary.rows).contains(&summary.rows_made) {
        progress.say(&format!(
            "{}: {} rows were there already",
            out.display(),
            summary.rows - summary.rows_made
        ));
    }
    let seconds = progress.finish();
    write_file(&out.join("config.toml"), toml::to_string(config)?)?;
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
