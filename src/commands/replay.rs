//! `flowservo dataset replay`: makes a row again and compares it with what is stored.

use crate::file::write_file;
use crate::output::{out, print_json};
use anyhow::{Context, Result, bail};
use datagen::replay::Comparison;
use datagen::{DatasetReader, Replay};
use serde::Serialize;
use std::path::{Path, PathBuf};
use world::units::to_mm;

/// What is said of a row to scripts.
#[derive(Serialize)]
struct Replayed<'a> {
    dataset: &'a str,
    row: u64,
    motion: &'a str,
    target: String,
    obstacles: usize,
    identical: bool,
    columns: &'a [Comparison],
    /// Files that were written.
    images: Vec<PathBuf>,
    /// Version of flowservo that wrote the dataset.
    written_by: &'a str,
}

/// Runs the command.
pub(crate) fn run(dataset: &Path, row: u64, out: Option<&Path>, json: bool) -> Result<()> {
    let reader = DatasetReader::open(dataset)?;
    let replay = datagen::replay(&reader, row);
    let other_version = other_version(&reader.info().version);
    let replay = match &other_version {
        Some(hint) => replay.with_context(|| format!("row {row} cannot be made again; {hint}"))?,
        None => replay?,
    };
    let images = out.map_or(Ok(Vec::new()), |out| write_images(out, row, &replay))?;
    let replayed = replayed(&reader, &replay, images);
    show(&replayed);
    print_json(json, &replayed)?;
    if replayed.identical {
        return Ok(());
    }
    let verify =
        || format!("compare the files with their digests: flowservo dataset verify {}", dataset.display());
    bail!(
        "row {row} of {} is not what its configuration makes ({} differ); {}",
        dataset.display(),
        replay.differing().join(", "),
        other_version.unwrap_or_else(verify)
    )
}

/// If the dataset was written by another version, that it was.
fn other_version(version: &str) -> Option<String> {
    let this = env!("CARGO_PKG_VERSION");
    (version != this).then(|| {
        format!("the dataset was written by flowservo {version}, and this is {this}, which may be why")
    })
}

fn replayed<'a>(reader: &'a DatasetReader, replay: &'a Replay, images: Vec<PathBuf>) -> Replayed<'a> {
    let (info, placement) = (reader.info(), &replay.example.placement);
    let shape = &placement.scene.target.shape;
    let [x, y, z] = shape.half_extents().map(|half| to_mm(2.0 * half)).into();
    Replayed {
        dataset: &info.name,
        row: replay.example.index,
        motion: &info.config.motions[placement.motion].name,
        target: format!("{}, {x:.0} x {y:.0} x {z:.0} mm", shape.name()),
        obstacles: placement.scene.obstacles.len(),
        identical: replay.differing().is_empty(),
        columns: &replay.columns,
        images,
        written_by: &info.version,
    }
}

fn show(replayed: &Replayed) {
    let differences: Vec<_> = replayed
        .columns
        .iter()
        .filter_map(|Comparison { column, difference }| Some((column, difference.as_ref()?)))
        .collect();
    let compared = replayed.columns.len();
    out!("row        {} of {}", replayed.row, replayed.dataset);
    out!("motion     {}", replayed.motion);
    out!("target     {}", replayed.target);
    out!("obstacles  {}", replayed.obstacles);
    out!("columns    {} of {compared} are the same to the bit", compared - differences.len());
    for (column, difference) in differences {
        out!("  {column:<24}  {difference}");
    }
    for image in &replayed.images {
        out!("image      {}", image.display());
    }
}

/// Writes both versions of each image beside each other.
fn write_images(out: &Path, row: u64, replay: &Replay) -> Result<Vec<PathBuf>> {
    let mut written = Vec::new();
    for pair in &replay.images {
        for (version, png) in [("made", &pair.made), ("stored", &pair.stored)] {
            let path = out.join(format!("{row:08}_{}_{version}.png", pair.column));
            write_file(&path, png)?;
            written.push(path);
        }
    }
    Ok(written)
}
