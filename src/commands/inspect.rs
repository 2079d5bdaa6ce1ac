//! `flowservo dataset info` and `show`: what a dataset holds, in numbers and in pictures.

use crate::cli;
use crate::error::bad_input;
use crate::file::write_file;
use crate::output::{out, print_json};
use ::report::dataset::contact_sheet::contact_sheet;
use ::report::dataset::selection::{drawn, evenly_spread};
use anyhow::{Result, anyhow};
use datagen::spread::Spread;
use datagen::statistics::{
    DatasetStatistics, LabelStatistics, MapStatistics, NormStatistics, TwistStatistics,
};
use datagen::{DatasetInfo, DatasetReader};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use world::units::{to_deg, to_mm};

/// What `--json` says of a dataset.
#[derive(Serialize)]
struct Described<'a> {
    #[serde(flatten)]
    info: &'a DatasetInfo,
    statistics: &'a DatasetStatistics,
}

/// Prints what a dataset holds.
pub(crate) fn info(dataset: &Path, json: bool) -> Result<()> {
    let reader = DatasetReader::open(dataset)?;
    let statistics = DatasetStatistics::of(&reader)?;
    let info = reader.info();
    print_identity(info, &statistics);
    print_counts(info, &statistics);
    match &statistics.labels {
        LabelStatistics::Twist(twist) => print_twist(twist),
        LabelStatistics::Values(values) => print_values(values),
    }
    print_hands(&statistics);
    print_json(json, &Described { info, statistics: &statistics })
}

/// Draws some rows of a dataset.
pub(crate) fn show(arguments: &cli::Show, json: bool) -> Result<()> {
    let reader = DatasetReader::open(&arguments.dataset)?;
    let (name, all) = (&reader.info().name, reader.info().rows);
    let rows = match arguments.seed {
        _ if !arguments.rows.is_empty() => arguments.rows.clone(),
        Some(seed) => drawn(all, arguments.count, seed),
        None => evenly_spread(all, arguments.count),
    };
    if let Some(row) = rows.iter().find(|&&row| row >= all) {
        let dataset = arguments.dataset.display();
        return Err(bad_input(anyhow!("--rows {row}: {dataset} has rows 0 to {}", all - 1)));
    }
    let out = arguments.out.clone().unwrap_or_else(|| PathBuf::from(format!("{name}-sheet.svg")));
    write_file(&out, contact_sheet(&reader, &rows)?)?;
    out!("{}: {} of {all} rows of {name}", out.display(), rows.len());
    print_json(json, &serde_json::json!({ "sheet": out, "rows": rows }))
}

fn print_identity(info: &DatasetInfo, statistics: &DatasetStatistics) {
    let (camera, bytes) = (&info.config.world.camera, &statistics.bytes);
    let files = if info.files.len() == 1 { "file" } else { "files" };
    out!("{}  {} dataset, made by flowservo {}\n", info.name, info.config.kind, info.version);
    out!("rows       {} in {} {files}, {} images", info.rows, info.files.len(), info.images);
    out!(
        "images     {} x {} pixels, {}° wide, {} each",
        camera.width,
        camera.height,
        camera.horizontal_fov_deg,
        in_bytes(bytes.images / info.images.max(1))
    );
    let [total, images, labels, metadata] =
        [bytes.total, bytes.images, bytes.labels, bytes.metadata].map(in_bytes);
    out!("size       {total}: images {images}, labels and scenes {labels}, metadata {metadata}");
    out!("seed       {}", info.config.seed);
    out!("digest     {}\n", info.digest);
}

fn print_counts(info: &DatasetInfo, statistics: &DatasetStatistics) {
    let width = statistics.motions.iter().map(|motion| motion.name.chars().count()).max().unwrap_or(0);
    for (i, motion) in statistics.motions.iter().enumerate() {
        let share = percent(motion.rows as f64 / info.rows as f64);
        let (head, asked) = (if i == 0 { "motions" } else { "" }, percent(motion.share));
        out!("{head:<9}  {:<width$}  {share}  (asked {})", motion.name, asked.trim());
    }
    out!("targets    {}", shares(&statistics.target_shapes, info.rows));
    out!("obstacles  {}\n", shares(&statistics.obstacles, info.rows));
}

/// How often each kind is, in one line.
fn shares<T: Display>(counts: &BTreeMap<T, u64>, rows: u64) -> String {
    let share =
        |(kind, count): (&T, &u64)| format!("{kind}: {}", percent(*count as f64 / rows as f64).trim());
    counts.iter().map(share).collect::<Vec<_>>().join("   ")
}

/// A unit's sign, and what turns SI into it.
type Unit = (&'static str, fn(f64) -> f64);
const POSITION: Unit = ("mm", to_mm);
const ANGLE: Unit = ("deg", to_deg);
/// The six numbers of a pose.
const AXES: [(&str, Unit); 6] =
    [("x", POSITION), ("y", POSITION), ("z", POSITION), ("phi", ANGLE), ("theta", ANGLE), ("psi", ANGLE)];

fn print_twist(twist: &TwistStatistics) {
    out!("twist                min     mean      std      max   median     95 %");
    let spread = |spread: &Spread, convert: fn(f64) -> f64| {
        [spread.min, spread.mean, spread.std, spread.max].map(|v| format!("{:9.2}", convert(v))).concat()
    };
    for ((name, (unit, convert)), axis) in AXES.iter().zip(twist.axes.to_array()) {
        out!("  {name:<7} {unit:<4}{}", spread(&axis, *convert));
    }
    for (name, (unit, convert), norm) in
        [("length", POSITION, &twist.translation_m), ("angle", ANGLE, &twist.rotation_rad)]
    {
        let NormStatistics { spread: all, median, percentile_95 } = norm;
        let [median, percentile_95] = [*median, *percentile_95].map(convert);
        out!("  {name:<7} {unit:<4}{}{median:9.2}{percentile_95:9.2}", spread(all, convert));
    }
    out!("");
}

fn print_values(values: &MapStatistics) {
    let MapStatistics { spread: Spread { mean, std, .. }, free, blocked, tenths } = values;
    out!("values     mean {mean:.3}, standard deviation {std:.3}");
    out!(
        "           free (0) {}, blocked (0.5 and more) {}",
        percent(*free).trim(),
        percent(*blocked).trim()
    );
    for (i, share) in tenths.iter().enumerate() {
        let bar = "#".repeat((share * 100.0).round() as usize);
        out!("  {:.1} to {:.1}  {}  {bar}", i as f64 / 10.0, (i + 1) as f64 / 10.0, percent(*share));
    }
    out!("");
}

fn print_hands(statistics: &DatasetStatistics) {
    let range = |spread: &Spread, convert: fn(f64) -> f64| {
        format!("{:9.1} to {:6.1}", convert(spread.min), convert(spread.max))
    };
    let heads: Vec<String> = statistics.hands.iter().map(|hand| format!("{:>19}", hand.name)).collect();
    out!("ranges        {}{:>19}", heads.concat(), "limits");
    for (axis, (name, (unit, convert))) in AXES.iter().enumerate() {
        let ranges = statistics.hands.iter().map(|hand| range(&hand.pose.to_array()[axis], *convert));
        out!("  {name:<7} {unit:<4}{}", ranges.collect::<String>());
    }
    for (joint, [lower, upper]) in statistics.joint_limits_rad.iter().enumerate() {
        let ranges = statistics.hands.iter().map(|hand| range(&hand.joints_rad[joint], to_deg));
        let [lower, upper] = [*lower, *upper].map(to_deg);
        out!("  joint {} deg {}{lower:9.1} to {upper:6.1}", joint + 1, ranges.collect::<String>());
    }
    let margins = statistics.hands.iter().map(|hand| hand.joint_margin(&statistics.joint_limits_rad));
    if let Some((margin, joint)) = margins.min_by(|a, b| a.0.total_cmp(&b.0)) {
        out!("  no joint comes nearer to a limit than {:.1}° (joint {})", to_deg(margin), joint + 1);
    }
}

fn percent(share: f64) -> String {
    format!("{:5.1} %", share * 100.0)
}

/// A size as people read it.
fn in_bytes(bytes: u64) -> String {
    match bytes as f64 {
        bytes if bytes < 1e3 => format!("{bytes} bytes"),
        bytes if bytes < 1e6 => format!("{:.1} kB", bytes / 1e3),
        bytes if bytes < 1e9 => format!("{:.1} MB", bytes / 1e6),
        bytes => format!("{:.1} GB", bytes / 1e9),
    }
}
