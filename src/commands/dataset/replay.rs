//! `flowservo dataset replay`: generates a row again and compares it with the stored one.

use crate::file::write_file;
use crate::output::{out, print_json};
use anyhow::{Context, Result, bail};
use datagen::read::Comparison;
use datagen::{DatasetReader, Replay};
use serde::Serialize;
use std::path::{Path, PathBuf};
use world::units::to_mm;

/// JSON form of the result.
#[derive(Serialize)]
struct Replayed<'a> {
    dataset: &'a str,
    row: u64,
    motion: &'a str,
    target: String,
    obstacles: usize,
    identical: bool,
    columns: &'a [Comparison],
    /// Image files written by this command.
    images: Vec<PathBuf>,
    /// Version of flowservo that generated the dataset.
    written_by: &'a str,
}

/// Runs the command.
pub(crate) fn run(dataset: &Path, row: u64, out: Option<&Path>, json: bool) -> Result<()> {
    let reader = DatasetReader::open(dataset)?;
    let replay = datagen::replay(&reader, row);
    let other_version = other_version(&reader.info().version);
    let replay = match &other_version {
        Some(hint) => replay.with_context(|| format!("row {row} cannot be generated again; {hint}"))?,
        None => replay?,
    };
    let images = out.map_or(Ok(Vec::new()), |out| write_images(out, row, &replay))?;
    let replayed = replayed(&reader, &replay, images);
    show(&replayed);
    print_json(json, &replayed)?;
    if replayed.identical {
        return Ok(());
    }
    let verify = || format!("check the files: flowservo dataset verify {}", dataset.display());
    bail!(
        "row {row} of {} differs from the one generated now ({} differ); {}",
        dataset.display(),
        replay.differing().join(", "),
        other_version.unwrap_or_else(verify)
    )
}

/// Returns a hint if another version of flowservo wrote the dataset.
fn other_version(version: &str) -> Option<String> {
    let this = env!("CARGO_PKG_VERSION");
    (version != this).then(|| {
        format!("the dataset was written by flowservo {version}, but this is {this}, which may be the cause")
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
    out!("columns    {} of {compared} are identical", compared - differences.len());
    for (column, difference) in differences {
        out!("  {column:<24}  {difference}");
    }
    for image in &replayed.images {
        out!("image      {}", image.display());
    }
}

/// Writes the generated and the stored version of each image.
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
