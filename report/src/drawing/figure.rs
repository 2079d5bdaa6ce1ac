//! A figure with its caption, and the layout that figures share.

use super::svg::Area;

/// A figure with its caption.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// Number or title, such as "Figure 8".
    pub label: String,
    /// Drawing, an SVG document without external resources.
    pub svg: String,
    /// What the figure shows and how it differs from the paper's, as plain text.
    pub caption: String,
}

/// Width of every figure, about the number of pixels at which a page shows it.
pub(crate) const WIDTH: f64 = 960.0;
/// Space between panels.
pub(crate) const GAP: f64 = 12.0;

/// Returns `count` panels side by side over the whole width. `aspect` is their width over height.
pub(crate) fn row(count: usize, top: f64, aspect: f64) -> Vec<Area> {
    let width = (WIDTH - GAP * (count as f64 - 1.0)) / count as f64;
    (0..count).map(|i| Area { x: i as f64 * (width + GAP), y: top, width, height: width / aspect }).collect()
}
