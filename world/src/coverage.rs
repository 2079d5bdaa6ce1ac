//! From cells to pixels: each patch adds its color to a pixel in proportion to the area it covers, which is exact for
//! straight edges.

use crate::scan::{Cell, Edge};
use crate::scene::{Color, Light};
use crate::surface::{Patch, Shading, SurfaceOnLine};
use crate::texture::{TextureInView, Weave};
use crate::view::View;
use nalgebra::{Point2, Vector3};
use std::ops::Range;

/// Writes an image row by row. In a row that lies within one cell, pixels of one patch are written at once; all others
/// are summed up until the row is complete.
pub(crate) struct Canvas<'a> {
    view: &'a View<'a>,
    bytes: &'a mut [u8],
    /// Color and covered area of the current row's pixels, as far as they are summed up one by one.
    sums: Vec<Sum>,
    /// Where there are such sums.
    summed: Vec<Range<usize>>,
    /// For what covers many pixels alike: by how much the sums change from one pixel to the next.
    steps: Vec<Sum>,
    /// Where there are such steps.
    stepped: Vec<usize>,
    /// Does the current row consist of several cells?
    is_mixed: bool,
    edges: Vec<EdgeInRow>,
    /// y of the rays through the middle of the row, as far as the cell has it.
    y: f64,
    /// Looks at the patches' textures.
    weaves: Vec<Option<Weave<'a>>>,
}

/// Red, green and blue, each times the area, and the area.
type Sum = [f64; 4];

/// An edge within a part of an image row, as a chord of the right area.
#[derive(Debug, Clone, Copy)]
struct EdgeInRow {
    /// Leftmost place \[pixels\].
    from: f64,
    /// Rightmost place.
    to: f64,
}

impl EdgeInRow {
    fn new(edge: &Edge, top: f64, bottom: f64, width: f64) -> Self {
        let (above, below) = (edge.at(top), edge.at(bottom));
        let mean = (above + 4.0 * edge.at(0.5 * (top + bottom)) + below) / 6.0;
        let reach = (above - below).abs() / 2.0;
        Self { from: (mean - reach).clamp(0.0, width), to: (mean + reach).clamp(0.0, width) }
    }

    /// The share of a pixel that lies to the right.
    fn right_of(&self, pixel: usize) -> f64 {
        let end = pixel as f64 + 1.0;
        let run = self.to - self.from;
        if run < 1e-6 {
            return (end - 0.5 * (self.from + self.to)).clamp(0.0, 1.0);
        }
        // Integral of clamp(w, 0, 1).
        let integral = |w: f64| if w < 1.0 { w.max(0.0) * w.max(0.0) / 2.0 } else { w - 0.5 };
        (integral(end - self.from) - integral(end - self.to)) / run
    }

    fn middle(&self) -> f64 {
        0.5 * (self.from + self.to)
    }
}

impl<'a> Canvas<'a> {
    /// For an image of the view, given as its bytes.
    pub(crate) fn new(view: &'a View<'a>, bytes: &'a mut [u8]) -> Self {
        let width = view.camera.width as usize;
        let (sums, steps) = (vec![Sum::default(); width], vec![Sum::default(); width + 1]);
        let weaves =
            view.patches.iter().map(|patch| patch.texture.as_ref().map(TextureInView::weave)).collect();
        Self {
            view,
            bytes,
            sums,
            summed: Vec::new(),
            steps,
            stepped: Vec::new(),
            is_mixed: false,
            edges: Vec::new(),
            y: 0.0,
            weaves,
        }
    }

    /// Draws a cell; cells come from top to bottom without gaps.
    pub(crate) fn draw(&mut self, cell: &Cell) {
        let width = f64::from(self.view.camera.width);
        for row in cell.top.floor() as usize..cell.bottom.ceil() as usize {
            let (top, bottom) = (cell.top.max(row as f64), cell.bottom.min(row as f64 + 1.0));
            self.is_mixed = bottom - top < 1.0;
            self.y = self.view.camera.ray(&Point2::new(0.0, 0.5 * (top + bottom))).y;
            self.edges.clear();
            self.edges.extend(cell.edges.iter().map(|edge| EdgeInRow::new(edge, top, bottom, width)));
            for (i, &patch) in cell.patches.iter().enumerate() {
                self.draw_span(row, [top, bottom], [self.edges[i], self.edges[i + 1]], patch);
            }
            if bottom >= row as f64 + 1.0 {
                if self.is_mixed { self.finish_mixed(row) } else { self.finish(row) }
            }
        }
    }

    fn draw_span(&mut self, row: usize, [top, bottom]: [f64; 2], [left, right]: [EdgeInRow; 2], patch: u16) {
        let View { camera, light, patches, .. } = self.view;
        let weave = self.weaves[usize::from(patch)].as_mut();
        let mut shade = Shade::new(light, &patches[usize::from(patch)], self.y, weave);
        let constant = shade.constant();
        let mut color =
            |u: f64| shade.color(&Vector3::new((u - camera.center.x) / camera.focal, self.y, 1.0), light);
        let height = bottom - top;
        let (begin, end) = (left.from.floor() as usize, right.to.ceil() as usize);
        let inner = left.to.ceil() as usize..right.from.floor() as usize;
        // The middle of what a pixel has of the span, for its color.
        let place =
            |pixel: usize| 0.5 * (left.middle().max(pixel as f64) + right.middle().min(pixel as f64 + 1.0));
        let mut sum_up = |pixels: Range<usize>| {
            for pixel in pixels.clone() {
                let area = height * (left.right_of(pixel) - right.right_of(pixel));
                add(&mut self.sums[pixel], color(place(pixel)), area);
            }
            self.summed.push(pixels);
        };
        if inner.is_empty() {
            sum_up(begin..end);
            return;
        }
        sum_up(begin..inner.start);
        sum_up(inner.end..end);
        let start = 3 * self.sums.len() * row;
        let bytes = &mut self.bytes[start + 3 * inner.start..start + 3 * inner.end];
        match (constant, self.is_mixed) {
            (Some(color), true) => {
                add(&mut self.steps[inner.start], color, height);
                add(&mut self.steps[inner.end], color, -height);
                self.stepped.extend([inner.start, inner.end]);
            }
            (None, true) => {
                for pixel in inner {
                    add(&mut self.sums[pixel], color(pixel as f64 + 0.5), height);
                }
            }
            (Some(color), false) => fill(bytes, to_bytes(color)),
            (None, false) => {
                for (pixel, bytes) in inner.zip(bytes.chunks_exact_mut(3)) {
                    bytes.copy_from_slice(&to_bytes(color(pixel as f64 + 0.5)));
                }
            }
        }
    }

    /// Writes the sums of a row within one cell.
    fn finish(&mut self, row: usize) {
        let start = self.sums.len() * row;
        for pixel in self.summed.drain(..).flatten() {
            let [red, green, blue, area] = std::mem::take(&mut self.sums[pixel]);
            if area > 0.0 {
                let begin = 3 * (start + pixel);
                self.bytes[begin..begin + 3].copy_from_slice(&to_bytes([red, green, blue]));
            }
        }
    }

    /// Writes the sums of a row that consists of several cells.
    fn finish_mixed(&mut self, row: usize) {
        self.summed.clear();
        let width = self.sums.len();
        let bytes = &mut self.bytes[3 * width * row..3 * width * (row + 1)];
        self.stepped.extend([0, width]);
        self.stepped.sort_unstable();
        self.stepped.dedup();
        let mut level = Sum::default();
        for run in self.stepped.windows(2).map(|ends| ends[0]..ends[1]) {
            level = plus(level, std::mem::take(&mut self.steps[run.start]));
            let [red, green, blue, _] = level;
            fill(&mut bytes[3 * run.start..3 * run.end], to_bytes([red, green, blue]));
            for pixel in run {
                if self.sums[pixel][3] != 0.0 {
                    let [red, green, blue, _] = plus(level, std::mem::take(&mut self.sums[pixel]));
                    bytes[3 * pixel..3 * pixel + 3].copy_from_slice(&to_bytes([red, green, blue]));
                }
            }
        }
        self.steps[width] = Sum::default();
        self.stepped.clear();
    }
}

/// The color of a patch along an image line.
enum Shade<'a, 'b> {
    /// Of a flat surface.
    Constant(Color),
    /// Of a round one.
    Round(Color, Shading),
    /// Of one with a texture.
    Dyed(&'a mut Weave<'b>, &'a Patch, SurfaceOnLine<'a>),
}

impl<'a, 'b> Shade<'a, 'b> {
    fn new(light: &Light, patch: &'a Patch, y: f64, weave: Option<&'a mut Weave<'b>>) -> Self {
        match (weave, patch.surface.on_line(y)) {
            (Some(weave), surface) => Self::Dyed(weave, patch, surface),
            (None, SurfaceOnLine::Flat(_)) => Self::Constant(lit(patch.color, patch.brightness)),
            (None, SurfaceOnLine::Round(quadric)) => Self::Round(patch.color, quadric.shading(light)),
        }
    }

    /// The color of all the line, if it has but one.
    fn constant(&self) -> Option<Color> {
        match self {
            Self::Constant(color) => Some(*color),
            Self::Round(..) | Self::Dyed(..) => None,
        }
    }

    fn color(&mut self, ray: &Vector3<f64>, light: &Light) -> Color {
        match self {
            Self::Constant(color) => *color,
            Self::Round(color, shading) => lit(*color, shading.at(ray.x)),
            Self::Dyed(weave, patch, surface) => {
                let (nearness, normal, brightness) = match surface {
                    SurfaceOnLine::Flat(plane) => (plane.dot(ray), **plane, patch.brightness),
                    SurfaceOnLine::Round(quadric) => {
                        let (nearness, normal) = quadric.entry(ray.x);
                        (nearness, normal, light.on(&normal))
                    }
                };
                lit(weave.dye(patch.color, ray, nearness, &normal), brightness)
            }
        }
    }
}

fn lit(color: Color, brightness: f64) -> Color {
    color.map(|c| c * brightness)
}

fn plus(a: Sum, b: Sum) -> Sum {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]]
}

fn add(sum: &mut Sum, [red, green, blue]: Color, area: f64) {
    *sum = plus(*sum, [red * area, green * area, blue * area, area]);
}

fn to_bytes(color: Color) -> [u8; 3] {
    color.map(|c| (255.0 * c + 0.5) as u8)
}

fn fill(bytes: &mut [u8], color: [u8; 3]) {
    let block: [u8; 48] = std::array::from_fn(|i| color[i % 3]);
    let mut filled = block.len().min(bytes.len());
    bytes[..filled].copy_from_slice(&block[..filled]);
    // What is filled is copied behind itself: a few long copies instead of many short ones.
    while filled < bytes.len() {
        let more = filled.min(bytes.len() - filled);
        bytes.copy_within(..more, filled);
        filled += more;
    }
}
