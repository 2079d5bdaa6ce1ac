//! The paper's figures, drawn from sessions, and contact sheets of datasets: SVG with everything inside, and what must be
//! said beside it.

pub mod avoidance_maps;
pub mod contact_sheet;
pub mod final_poses;
pub mod flow;
mod hemisphere;
pub mod onlooker;
pub mod pose_error;
pub mod snapshots;
pub mod training_curves;

use crate::svg::Area;

/// A figure with its caption.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// Its number, as in "Figure 8".
    pub label: String,
    /// The drawing, an SVG document without external resources.
    pub svg: String,
    /// What is seen, and how it differs from the paper; plain text.
    pub caption: String,
}

/// Width of every figure; a page shows it at about this many pixels.
pub(crate) const WIDTH: f64 = 960.0;
/// Space between panels.
pub(crate) const GAP: f64 = 12.0;

/// `count` panels side by side over the whole width; their height follows from the images' width over height.
pub(crate) fn row(count: usize, top: f64, aspect: f64) -> Vec<Area> {
    let width = (WIDTH - GAP * (count as f64 - 1.0)) / count as f64;
    (0..count).map(|i| Area { x: i as f64 * (width + GAP), y: top, width, height: width / aspect }).collect()
}
