//! A pass of a convolution over a batch on the CPU, in pieces that fit the caches, over all threads.
//!
//! No patch is copied: what a section of the pixels sees is copied once into a window with room for the padding, from which
//! the products read the patches where they lie.

use std::ops::Range;

use rayon::prelude::*;

use super::conv_simd::{Multiply, TAIL, lanes, panel_columns};

/// Elements of a window that leave room for a panel in a 1 MiB L2 cache.
const WINDOW: usize = 64 * 1024;
/// Fewest pixels worth a task of their own.
const PIXELS: usize = 192;

/// `output[first + step * i] = sum over taps of source[begin + stride * i + tap] * weight[tap]`, where the source is zero
/// outside. Sizes and positions are those of rows and columns; the third of a size is its channels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pass {
    pub(super) source: [usize; 3],
    pub(super) begin: [isize; 2],
    pub(super) pixels: [usize; 2],
    pub(super) stride: usize,
    pub(super) taps: [usize; 2],
    pub(super) output: [usize; 3],
    pub(super) first: [usize; 2],
    pub(super) step: usize,
}

/// Rows of pixels of some images; all their rows if there are several images.
#[derive(Clone, Debug)]
pub(super) struct Section {
    pub(super) images: Range<usize>,
    pub(super) rows: Range<usize>,
}

impl Pass {
    pub(super) fn patch(&self) -> usize {
        self.taps[0] * self.run_len()
    }

    /// Elements of a row of a patch, contiguous in a window.
    pub(super) fn run_len(&self) -> usize {
        self.taps[1] * self.source[2]
    }

    /// Elements from one row of a window to the next.
    pub(super) fn row_step(&self) -> usize {
        self.window(1)[1] * self.source[2]
    }

    /// Rows and columns of the part of the source that `rows` rows of pixels see.
    fn window(&self, rows: usize) -> [usize; 2] {
        [(rows, 0), (self.pixels[1], 1)].map(|(pixels, axis)| (pixels - 1) * self.stride + self.taps[axis])
    }

    fn window_len(&self, rows: usize) -> usize {
        self.window(rows).iter().product::<usize>() * self.source[2]
    }

    /// The pixels of a batch in sections of about the size of a cache, in their order.
    pub(super) fn sections(&self, batch: usize) -> Vec<Section> {
        let [rows, columns] = self.pixels;
        let image = self.window_len(rows);
        if image <= WINDOW {
            let images = (WINDOW / image).min(PIXELS.div_ceil(rows * columns));
            let section = |first| Section { images: first..(first + images).min(batch), rows: 0..rows };
            return (0..batch).step_by(images).map(section).collect();
        }
        let band = rows.div_ceil(image.div_ceil(WINDOW));
        let bands = move |image| {
            let section =
                move |first| Section { images: image..image + 1, rows: first..(first + band).min(rows) };
            (0..rows).step_by(band).map(section)
        };
        (0..batch).flat_map(bands).collect()
    }

    /// Copies what a section sees of the source, with zeros outside, image after image.
    fn fill_window(&self, section: &Section, source: &[f32], window: &mut Vec<f32>) {
        let [height, width, channels] = self.source;
        let [rows, columns] = self.window(section.rows.len());
        let [top, left] = self.begin;
        let top = top + (section.rows.start * self.stride).cast_signed();
        // The columns of the window that lie in the source.
        let inside = |position: isize| position.clamp(0, width.cast_signed()).cast_unsigned();
        let (begin, end) = (inside(left), inside(left + columns.cast_signed()));
        let skipped = (begin.cast_signed() - left).cast_unsigned() * channels;
        let lines = section.images.len() * rows;
        window.clear();
        window.resize(lines * columns * channels + TAIL, 0.0);
        for (line, to) in window.chunks_exact_mut(columns * channels).take(lines).enumerate() {
            let (image, row) = (section.images.start + line / rows, top + (line % rows).cast_signed());
            if (0..height.cast_signed()).contains(&row) && begin < end {
                let from = (image * height + row.cast_unsigned()) * width;
                let from = &source[(from + begin) * channels..(from + end) * channels];
                to[skipped..skipped + from.len()].copy_from_slice(from);
            }
        }
    }

    /// Of each pixel of a section, where its patch begins in the section's window and its result in the section's output.
    fn fill_places(&self, section: &Section, places: &mut Vec<[usize; 2]>) {
        let [rows, columns] = self.window(section.rows.len());
        let [height, width, channels] = self.output;
        places.clear();
        for image in 0..section.images.len() {
            for y in 0..section.rows.len() {
                let from = (image * rows + y * self.stride) * columns;
                let to = (image * height + self.first[0] + y * self.step) * width + self.first[1];
                let place = |x| [(from + x * self.stride) * self.source[2], (to + x * self.step) * channels];
                places.extend((0..self.pixels[1]).map(place));
            }
        }
    }

    /// Where the section's output begins, and its length.
    fn section_output(&self, section: &Section) -> usize {
        let [height, width, channels] = self.output;
        let end = if section.rows.end == self.pixels[0] { height } else { section.rows.end * self.step };
        section.images.len() * (end - section.rows.start * self.step) * width * channels
    }
}

/// Packs some columns into a `[patch, width]` panel of zeros.
pub(super) type Pack<'a> = dyn Fn(Range<usize>, usize, &mut [f32]) + Sync + 'a;

/// The right side of a product, to be packed in panels that the tiles read from front to end.
pub(super) struct Panels<'a> {
    pub(super) patch: usize,
    pub(super) columns: usize,
    pub(super) pack: &'a Pack<'a>,
    /// Of each column; empty for none.
    pub(super) bias: &'a [f32],
    /// Of the rectifier; 1 for none.
    pub(super) slope: f32,
}

/// Some columns, packed.
struct Panel {
    columns: Range<usize>,
    values: Vec<f32>,
    bias: Vec<f32>,
    slope: f32,
}

impl Panels<'_> {
    fn ranges(&self) -> Vec<Range<usize>> {
        let width = panel_columns();
        (0..self.columns).step_by(width).map(|first| first..(first + width).min(self.columns)).collect()
    }

    fn packed(&self, columns: Range<usize>) -> Panel {
        let width = if columns.len() <= lanes() { lanes() } else { panel_columns() };
        let (mut values, mut bias) = (vec![0.0; self.patch * width], vec![0.0; width]);
        (self.pack)(columns.clone(), width, &mut values);
        if !self.bias.is_empty() {
            bias[..columns.len()].copy_from_slice(&self.bias[columns.clone()]);
        }
        Panel { columns, values, bias, slope: self.slope }
    }
}

/// A window on a section's source, and the places of its pixels: memory that a thread uses again.
#[derive(Default)]
pub(super) struct Scratch {
    pub(super) window: Vec<f32>,
    pub(super) places: Vec<[usize; 2]>,
}

impl Pass {
    /// Computes those positions of `output` that are this pass's.
    pub(super) fn run(&self, batch: usize, source: &[f32], panels: &Panels, output: &mut [f32]) {
        let fewer_pixels = batch * self.window_len(self.pixels[0]) < self.patch() * panels.columns;
        if fewer_pixels && panels.columns > panel_columns() {
            self.by_panels(batch, source, panels, output);
        } else {
            self.by_sections(batch, source, panels, output);
        }
    }

    /// Many pixels, few weights: each task takes a section of the pixels.
    fn by_sections(&self, batch: usize, source: &[f32], panels: &Panels, output: &mut [f32]) {
        let packed: Vec<_> = panels.ranges().into_par_iter().map(|columns| panels.packed(columns)).collect();
        let mut rest = output;
        let mut tasks = Vec::new();
        for section in self.sections(batch) {
            let (part, others) = rest.split_at_mut(self.section_output(&section));
            tasks.push((section, part));
            rest = others;
        }
        tasks.into_par_iter().for_each_init(Scratch::default, |scratch, (section, output)| {
            self.fill(&section, source, scratch);
            for panel in &packed {
                let output = &mut output[panel.columns.start..];
                self.product(&scratch.window, &scratch.places, panel, output);
            }
        });
    }

    /// Few pixels, many weights: each task takes a panel, packs it, and is done with it.
    fn by_panels(&self, batch: usize, source: &[f32], panels: &Panels, output: &mut [f32]) {
        let mut scratch = Scratch::default();
        self.fill(&Section { images: 0..batch, rows: 0..self.pixels[0] }, source, &mut scratch);
        let Scratch { window, places } = scratch;
        let product = |columns: Range<usize>| {
            let width = columns.len();
            let dense: Vec<_> = places.iter().enumerate().map(|(i, place)| [place[0], i * width]).collect();
            let mut result = vec![0.0; places.len() * width];
            self.product(&window, &dense, &panels.packed(columns.clone()), &mut result);
            (columns.start, result)
        };
        let results: Vec<_> = panels.ranges().into_par_iter().map(product).collect();
        for (column, result) in results {
            for (place, result) in places.iter().zip(result.chunks_exact(result.len() / places.len())) {
                output[place[1] + column..][..result.len()].copy_from_slice(result);
            }
        }
    }

    pub(super) fn fill(&self, section: &Section, source: &[f32], scratch: &mut Scratch) {
        self.fill_window(section, source, &mut scratch.window);
        self.fill_places(section, &mut scratch.places);
    }

    fn product(&self, window: &[f32], places: &[[usize; 2]], panel: &Panel, output: &mut [f32]) {
        let product = Multiply {
            source: window,
            places,
            run: self.run_len(),
            row_step: self.row_step(),
            panel: &panel.values,
            patch: self.patch(),
            bias: &panel.bias,
            slope: panel.slope,
            output,
            columns: panel.columns.len(),
        };
        product.run();
    }
}
