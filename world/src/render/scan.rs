//! Divides the visible image into cells. A cell is a range of image lines that show the same patches side by side, between edges
//! that are parabolas to within a few thousandths of a pixel.
//!
//! The content of a single image line is exact ([`Scanner::trace`]): of the strips at a place, the nearest is visible. A cell is
//! accepted if three of its lines show the same patches and its edges are smooth enough. Otherwise it is split: where two edges
//! appear to meet, or evenly. A straight edge of any length therefore needs three lines.

use crate::render::silhouette::{ImageLine, Strip};
use crate::render::view::View;
use nalgebra::{Point2, Vector3};

/// Offset of the outer lines of a cell from its middle, as a fraction of its height. At these Gauss points, a parabola through
/// three points of an edge has the right area.
const GAUSS: f64 = 0.387_298_334_620_741_7;
/// Maximum deviation of an edge from its chord within an image row \[pixels\].
const BEND_IN_ROW: f64 = 0.004;
/// Maximum deviation of an edge from its chord within a cell, where it is drawn as a parabola. It is small because the curvature
/// of the edge varies \[pixels\].
const BEND_IN_CELL: f64 = 0.008;
/// Minimum height at which a cell is split \[pixels\].
const LEAST_HEIGHT: f64 = 1.0 / 256.0;
/// Maximum height of a cell, and spacing of additional cuts, where surfaces cross \[pixels\].
const CROSSING_STEP: usize = 8;

/// Content of an image line: patch i is visible from edge i to edge i + 1. The outer edges are the borders of the image
/// \[pixels\].
#[derive(Debug, Clone, Default)]
pub(crate) struct Line {
    pub(crate) v: f64,
    pub(crate) edges: Vec<f64>,
    pub(crate) patches: Vec<u16>,
}

/// An edge as a function of the height v in the image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Edge {
    middle: f64,
    coefficients: [f64; 3],
}

impl Edge {
    fn vertical(u: f64) -> Self {
        Self { middle: 0.0, coefficients: [u, 0.0, 0.0] }
    }

    /// Returns the position at a height.
    pub(crate) fn at(&self, v: f64) -> f64 {
        let [a, b, c] = self.coefficients;
        let d = v - self.middle;
        a + d * (b + d * c)
    }
}

/// Patches side by side between two heights.
#[derive(Debug, Clone, Default)]
pub(crate) struct Cell {
    pub(crate) top: f64,
    pub(crate) bottom: f64,
    pub(crate) edges: Vec<Edge>,
    pub(crate) patches: Vec<u16>,
}

/// A range of image lines that is not processed yet.
#[derive(Debug, Clone, Copy)]
struct Stretch {
    top: f64,
    bottom: f64,
    /// Whether it results from a split where edges were expected to meet. If it still is not smooth, it is halved instead.
    is_guess: bool,
}

/// Decision about a stretch.
enum Verdict {
    Accept,
    SplitEvenly(usize),
    SplitAt(f64),
}

/// Yields the cells of an image from top to bottom.
pub(crate) struct Scanner<'a> {
    view: &'a View<'a>,
    image_line: ImageLine,
    ends: Vec<f64>,
    lines: [Line; 3],
    cell: Cell,
    stretches: Vec<Stretch>,
}

impl<'a> Scanner<'a> {
    /// Creates a scanner of the whole image.
    pub(crate) fn new(view: &'a View<'a>) -> Self {
        let mut stretches: Vec<Stretch> = view
            .breaks
            .windows(2)
            .map(|pair| Stretch { top: pair[0], bottom: pair[1], is_guess: false })
            .collect();
        stretches.reverse();
        Self {
            view,
            image_line: ImageLine::default(),
            ends: Vec::new(),
            lines: std::array::from_fn(|_| Line::default()),
            cell: Cell::default(),
            stretches,
        }
    }

    /// Returns the next cell, which begins where the last one ended.
    pub(crate) fn next_cell(&mut self) -> Option<&Cell> {
        while let Some(stretch) = self.stretches.pop() {
            let (middle, height) = (0.5 * (stretch.top + stretch.bottom), stretch.bottom - stretch.top);
            let mut lines = std::mem::take(&mut self.lines);
            for (line, share) in lines.iter_mut().zip([-GAUSS, 0.0, GAUSS]) {
                self.trace(middle + share * height, line);
            }
            let verdict = self.judge(stretch, &lines);
            if matches!(verdict, Verdict::Accept) || height < LEAST_HEIGHT {
                self.accept(stretch, &lines, matches!(verdict, Verdict::Accept));
                self.lines = lines;
                return Some(&self.cell);
            }
            self.lines = lines;
            self.split(stretch, &verdict);
        }
        None
    }

    fn split(&mut self, Stretch { top, bottom, .. }: Stretch, verdict: &Verdict) {
        match *verdict {
            Verdict::Accept => {}
            Verdict::SplitAt(v) => {
                self.stretches.push(Stretch { top: v, bottom, is_guess: true });
                self.stretches.push(Stretch { top, bottom: v, is_guess: true });
            }
            Verdict::SplitEvenly(parts) => {
                let at = |i: usize| top + (bottom - top) * i as f64 / parts as f64;
                for i in (0..parts).rev() {
                    let end = if i + 1 == parts { bottom } else { at(i + 1) };
                    self.stretches.push(Stretch { top: at(i), bottom: end, is_guess: false });
                }
            }
        }
    }

    fn judge(&self, stretch: Stretch, [a, m, b]: &[Line; 3]) -> Verdict {
        let height = stretch.bottom - stretch.top;
        if self.view.crossing && height > CROSSING_STEP as f64 {
            return Verdict::SplitEvenly((height / CROSSING_STEP as f64).ceil() as usize);
        }
        let is_alike = a.patches == m.patches && m.patches == b.patches;
        if is_alike && is_in_order(stretch, [a, m, b]) {
            let bend = greatest_bend(a, m, b);
            let within_row = BEND_IN_ROW * (height * height).max(1.0);
            let limit = if bend <= within_row { BEND_IN_CELL } else { BEND_IN_ROW };
            if bend <= limit {
                return Verdict::Accept;
            }
            return Verdict::SplitEvenly(((bend / limit).sqrt().ceil() as usize).clamp(2, 16));
        }
        let meeting = || {
            let pairs = [(a, m), (b, m), (m, b), (m, a)];
            pairs.into_iter().find_map(|(first, second)| meeting_point(first, second, stretch))
        };
        match meeting() {
            Some(v) if !stretch.is_guess => Verdict::SplitAt(v),
            _ => Verdict::SplitEvenly(2),
        }
    }

    fn accept(&mut self, stretch: Stretch, [a, m, b]: &[Line; 3], is_smooth: bool) {
        self.cell.top = stretch.top;
        self.cell.bottom = stretch.bottom;
        self.cell.patches.clone_from(&m.patches);
        self.cell.edges.clear();
        if is_smooth {
            let step = (b.v - a.v) / 2.0;
            self.cell.edges.extend(a.edges.iter().zip(&m.edges).zip(&b.edges).map(|((&a, &at), &b)| Edge {
                middle: m.v,
                coefficients: [at, (b - a) / (2.0 * step), (a - 2.0 * at + b) / (2.0 * step * step)],
            }));
        } else {
            self.cell.edges.extend(m.edges.iter().map(|&u| Edge::vertical(u)));
        }
    }

    /// Finds the content of the image line at a height.
    pub(crate) fn trace(&mut self, v: f64, line: &mut Line) {
        let camera = self.view.camera;
        let (width, focal, center) = (f64::from(camera.width), camera.focal, camera.center.x);
        line.v = v;
        line.edges.clear();
        line.patches.clear();
        line.edges.push(0.0);
        self.image_line.y = camera.ray(&Point2::new(0.0, v)).y;
        self.image_line.from = -center / focal;
        self.image_line.to = (width - center) / focal;
        self.image_line.strips.clear();
        for (silhouette, [top, bottom]) in &self.view.silhouettes {
            if *top < v && v < *bottom {
                self.image_line.add(silhouette);
            }
        }
        self.ends.clear();
        self.ends.extend([0.0, width]);
        for strip in &mut self.image_line.strips {
            strip.from = (center + focal * strip.from).clamp(0.0, width);
            strip.to = (center + focal * strip.to).clamp(0.0, width);
            self.ends.extend([strip.from, strip.to]);
        }
        if self.view.crossing {
            self.ends.extend((CROSSING_STEP..camera.width as usize).step_by(CROSSING_STEP).map(|u| u as f64));
        }
        self.ends.sort_unstable_by(f64::total_cmp);
        for pair in self.ends.windows(2).filter(|pair| pair[1] - pair[0] > 1e-9) {
            if self.view.crossing {
                self.split_where_surfaces_cross(pair[0], pair[1], line);
            } else {
                line.show(self.nearest(0.5 * (pair[0] + pair[1])), pair[1]);
            }
        }
        line.edges.pop();
        line.edges.push(width);
    }

    fn ray(&self, u: f64) -> Vector3<f64> {
        let camera = self.view.camera;
        Vector3::new((u - camera.center.x) / camera.focal, self.image_line.y, 1.0)
    }

    /// Returns the patch that is visible at a place on the current image line.
    fn nearest(&self, u: f64) -> u16 {
        let ray = self.ray(u);
        let (mut nearest, mut greatest) = (0, 0.0);
        for Strip { patch, .. } in
            self.image_line.strips.iter().filter(|strip| strip.from < u && u < strip.to)
        {
            let nearness = self.view.patches[usize::from(*patch)].surface.nearness(&ray);
            // Where a body touches the table, the body is visible: bodies come first.
            if nearness > greatest * (1.0 + 1e-12) {
                (nearest, greatest) = (*patch, nearness);
            }
        }
        nearest
    }

    /// Continues the line between two neighboring ends of strips. The patches that are visible at the ends and in the middle may
    /// differ.
    fn split_where_surfaces_cross(&self, from: f64, to: f64, line: &mut Line) {
        let margin = 1e-4 * (to - from);
        let places = [from + margin, 0.5 * (from + to), to - margin];
        let patches = places.map(|u| self.nearest(u));
        for i in 0..2 {
            if patches[i] == patches[i + 1] {
                continue;
            }
            let (mut left, mut right) = (places[i], places[i + 1]);
            for _ in 0..40 {
                let middle = 0.5 * (left + right);
                if self.nearest(middle) == patches[i] {
                    left = middle;
                } else {
                    right = middle;
                }
            }
            line.show(patches[i], left);
        }
        line.show(patches[2], to);
    }
}

impl Line {
    /// Continues the line with a patch up to u.
    fn show(&mut self, patch: u16, u: f64) {
        if self.patches.last() == Some(&patch) {
            self.edges.pop();
        } else {
            self.patches.push(patch);
        }
        self.edges.push(u);
    }
}

/// Returns whether the edges keep their order up to the ends of the stretch.
fn is_in_order(stretch: Stretch, [a, m, b]: [&Line; 3]) -> bool {
    let step = (b.v - a.v) / 2.0;
    [stretch.top, stretch.bottom].into_iter().all(|v| {
        let d = (v - m.v) / step;
        let mut last = f64::NEG_INFINITY;
        (0..m.edges.len()).all(|i| {
            let (first, at, second) = (a.edges[i], m.edges[i], b.edges[i]);
            let u = at + d * ((second - first) / 2.0 + d * (first - 2.0 * at + second) / 2.0);
            let is_after = u >= last - 1e-3;
            last = u;
            is_after
        })
    })
}

/// Returns the maximum deviation of an edge at the middle line from its chord between the outer lines \[pixels\].
fn greatest_bend(a: &Line, m: &Line, b: &Line) -> f64 {
    let height = b.v - a.v;
    (0..m.edges.len()).fold(0.0, |greatest: f64, i| {
        let run = b.edges[i] - a.edges[i];
        let aside = m.edges[i] - 0.5 * (a.edges[i] + b.edges[i]);
        greatest.max(aside.abs() * height / (run * run + height * height).sqrt())
    })
}

/// Returns the height where two neighboring edges first meet, extrapolated from two lines with the same patches beyond the
/// second.
fn meeting_point(first: &Line, second: &Line, stretch: Stretch) -> Option<f64> {
    if first.patches != second.patches {
        return None;
    }
    let step = second.v - first.v;
    let gaps = |line: &Line, i: usize| line.edges[i + 1] - line.edges[i];
    let ahead = (0..second.patches.len()).filter_map(|i| {
        let (before, now) = (gaps(first, i), gaps(second, i));
        (before > now).then(|| now / (before - now))
    });
    let v = second.v + step * ahead.fold(f64::INFINITY, f64::min);
    let margin = LEAST_HEIGHT.min(stretch.bottom - stretch.top) / 4.0;
    (stretch.top < v && v < stretch.bottom).then(|| v.clamp(stretch.top + margin, stretch.bottom - margin))
}
