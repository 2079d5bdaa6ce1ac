//! Converts cells to pixels: each patch adds its color to a pixel in proportion to the area that it covers. Areas are exact for
//! straight edges.

use crate::color::Color;
use crate::render::quadric::Shading;
use crate::render::scan::{Cell, Edge};
use crate::render::surface::{Patch, SurfaceOnLine};
use crate::render::texture_sampler::{TextureInView, TextureSampler};
use crate::render::view::View;
use crate::scene::Light;
use nalgebra::{Point2, Vector3};
use std::ops::Range;

/// Writes an image row by row. In a row within one cell, pixels that show one patch are written immediately. All other pixels
/// accumulate colors until the row is complete.
pub(crate) struct Canvas<'a> {
    view: &'a View<'a>,
    bytes: &'a mut [u8],
    /// Sums of pixels of the current row that are accumulated one by one.
    sums: Vec<Sum>,
    /// Ranges of pixels with such sums.
    summed: Vec<Range<usize>>,
    /// Differences between the sums of neighboring pixels, for patches of constant color that cover many pixels.
    steps: Vec<Sum>,
    /// Pixels with such differences.
    stepped: Vec<usize>,
    /// Whether the current row consists of several cells.
    is_mixed: bool,
    edges: Vec<EdgeInRow>,
    /// y of the rays through the middle of the part of the row in the current cell.
    y: f64,
    /// Sampler of each patch's texture, if it has one.
    samplers: Vec<Option<TextureSampler<'a>>>,
}

/// Red, green and blue, each multiplied by the covered area, and that area.
type Sum = [f64; 4];

/// An edge within a part of an image row, as a chord with the right area on either side.
#[derive(Debug, Clone, Copy)]
struct EdgeInRow {
    /// Left end \[pixels\].
    from: f64,
    /// Right end \[pixels\].
    to: f64,
}

impl EdgeInRow {
    fn new(edge: &Edge, top: f64, bottom: f64, width: f64) -> Self {
        let (above, below) = (edge.at(top), edge.at(bottom));
        let mean = (above + 4.0 * edge.at(0.5 * (top + bottom)) + below) / 6.0;
        let reach = (above - below).abs() / 2.0;
        Self { from: (mean - reach).clamp(0.0, width), to: (mean + reach).clamp(0.0, width) }
    }

    /// Returns the fraction of a pixel to the right of the edge.
    fn right_of(&self, pixel: usize) -> f64 {
        let end = pixel as f64 + 1.0;
        let run = self.to - self.from;
        if run < 1e-6 {
            return (end - 0.5 * (self.from + self.to)).clamp(0.0, 1.0);
        }
        // The integral of clamp(w, 0, 1).
        let integral = |w: f64| if w < 1.0 { w.max(0.0) * w.max(0.0) / 2.0 } else { w - 0.5 };
        (integral(end - self.from) - integral(end - self.to)) / run
    }

    fn middle(&self) -> f64 {
        0.5 * (self.from + self.to)
    }
}

impl<'a> Canvas<'a> {
    /// Creates a canvas for an image of the view, given as its bytes.
    pub(crate) fn new(view: &'a View<'a>, bytes: &'a mut [u8]) -> Self {
        let width = view.camera.width as usize;
        let (sums, steps) = (vec![Sum::default(); width], vec![Sum::default(); width + 1]);
        let samplers =
            view.patches.iter().map(|patch| patch.texture.as_ref().map(TextureInView::sampler)).collect();
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
            samplers,
        }
    }

    /// Draws a cell. Cells must come from top to bottom without gaps.
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
        let sampler = self.samplers[usize::from(patch)].as_mut();
        let mut shade = Shade::new(light, &patches[usize::from(patch)], self.y, sampler);
        let constant = shade.constant();
        let mut color =
            |u: f64| shade.color(&Vector3::new((u - camera.center.x) / camera.focal, self.y, 1.0), light);
        let height = bottom - top;
        let (begin, end) = (left.from.floor() as usize, right.to.ceil() as usize);
        let inner = left.to.ceil() as usize..right.from.floor() as usize;
        // Where a pixel samples the color: the middle of its part of the span.
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

    /// Writes the accumulated pixels of a row within one cell.
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

    /// Writes the pixels of a row that consists of several cells.
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

/// Color of a patch along an image line.
enum Shade<'a, 'b> {
    /// A flat surface without texture.
    Constant(Color),
    /// A round surface without texture.
    Round(Color, Shading),
    /// A surface with texture.
    Textured(&'a mut TextureSampler<'b>, &'a Patch, SurfaceOnLine<'a>),
}

impl<'a, 'b> Shade<'a, 'b> {
    fn new(light: &Light, patch: &'a Patch, y: f64, sampler: Option<&'a mut TextureSampler<'b>>) -> Self {
        match (sampler, patch.surface.on_line(y)) {
            (Some(sampler), surface) => Self::Textured(sampler, patch, surface),
            (None, SurfaceOnLine::Flat(_)) => Self::Constant(lit(patch.color, patch.brightness)),
            (None, SurfaceOnLine::Round(quadric)) => Self::Round(patch.color, quadric.shading(light)),
        }
    }

    /// Returns the color of the whole line if it is constant.
    fn constant(&self) -> Option<Color> {
        match self {
            Self::Constant(color) => Some(*color),
            Self::Round(..) | Self::Textured(..) => None,
        }
    }

    fn color(&mut self, ray: &Vector3<f64>, light: &Light) -> Color {
        match self {
            Self::Constant(color) => *color,
            Self::Round(color, shading) => lit(*color, shading.at(ray.x)),
            Self::Textured(sampler, patch, surface) => {
                let (nearness, normal, brightness) = match surface {
                    SurfaceOnLine::Flat(plane) => (plane.dot(ray), **plane, patch.brightness),
                    SurfaceOnLine::Round(quadric) => {
                        let (nearness, normal) = quadric.entry(ray.x);
                        (nearness, normal, light.on(&normal))
                    }
                };
                lit(sampler.modulate(patch.color, ray, nearness, &normal), brightness)
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
    // Doubles the filled part with each copy: a few long copies instead of many short ones.
    while filled < bytes.len() {
        let more = filled.min(bytes.len() - filled);
        bytes.copy_within(..more, filled);
        filled += more;
    }
}
