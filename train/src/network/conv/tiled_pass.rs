//! A pass of a convolution over a batch on the CPU, in tiles that fit the cache, on all threads.
//!
//! There is no im2col buffer. The part of the source that a tile sees is copied once, with its zero padding, into a window,
//! and the micro-kernel reads the patches from there.

use std::ops::Range;

use rayon::prelude::*;

use super::micro_kernel::{Multiply, TAIL, lanes, panel_columns};

/// Elements of a window, chosen to leave room for a panel in an L2 cache of 1 MiB.
const WINDOW: usize = 64 * 1024;
/// Fewest pixels for a task of its own.
const PIXELS: usize = 192;

/// `output[first + step * i] = sum over taps of source[begin + stride * i + tap] * weight[tap]`, where the source is zero
/// outside. Pairs are rows and columns; the third size is channels.
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

/// Output pixels that are computed together: some rows of one image, or all rows of several images.
#[derive(Clone, Debug)]
pub(super) struct Tile {
    pub(super) images: Range<usize>,
    pub(super) rows: Range<usize>,
}

impl Pass {
    /// Elements of a patch.
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

    /// Rows and columns of the source that `rows` rows of pixels see.
    fn window(&self, rows: usize) -> [usize; 2] {
        [(rows, 0), (self.pixels[1], 1)].map(|(pixels, axis)| (pixels - 1) * self.stride + self.taps[axis])
    }

    fn window_len(&self, rows: usize) -> usize {
        self.window(rows).iter().product::<usize>() * self.source[2]
    }

    /// Splits the pixels of a batch into tiles of about the size of the cache, in order.
    pub(super) fn tiles(&self, batch: usize) -> Vec<Tile> {
        let [rows, columns] = self.pixels;
        let image = self.window_len(rows);
        if image <= WINDOW {
            let images = (WINDOW / image).min(PIXELS.div_ceil(rows * columns));
            let tile = |first| Tile { images: first..(first + images).min(batch), rows: 0..rows };
            return (0..batch).step_by(images).map(tile).collect();
        }
        let height = rows.div_ceil(image.div_ceil(WINDOW));
        let of_image = move |image| {
            let tile =
                move |first| Tile { images: image..image + 1, rows: first..(first + height).min(rows) };
            (0..rows).step_by(height).map(tile)
        };
        (0..batch).flat_map(of_image).collect()
    }

    /// Copies the part of the source that a tile sees, with zero padding, image after image.
    fn fill_window(&self, tile: &Tile, source: &[f32], window: &mut Vec<f32>) {
        let [height, width, channels] = self.source;
        let [rows, columns] = self.window(tile.rows.len());
        let [top, left] = self.begin;
        let top = top + (tile.rows.start * self.stride).cast_signed();
        // Columns of the window that are inside the source.
        let inside = |position: isize| position.clamp(0, width.cast_signed()).cast_unsigned();
        let (begin, end) = (inside(left), inside(left + columns.cast_signed()));
        let skipped = (begin.cast_signed() - left).cast_unsigned() * channels;
        let lines = tile.images.len() * rows;
        window.clear();
        window.resize(lines * columns * channels + TAIL, 0.0);
        for (line, to) in window.chunks_exact_mut(columns * channels).take(lines).enumerate() {
            let (image, row) = (tile.images.start + line / rows, top + (line % rows).cast_signed());
            if (0..height.cast_signed()).contains(&row) && begin < end {
                let from = (image * height + row.cast_unsigned()) * width;
                let from = &source[(from + begin) * channels..(from + end) * channels];
                to[skipped..skipped + from.len()].copy_from_slice(from);
            }
        }
    }

    /// Lists, for each pixel of a tile, the offset of its patch in the window and of its result in the tile's output.
    fn fill_offsets(&self, tile: &Tile, offsets: &mut Vec<[usize; 2]>) {
        let [rows, columns] = self.window(tile.rows.len());
        let [height, width, channels] = self.output;
        offsets.clear();
        for image in 0..tile.images.len() {
            for y in 0..tile.rows.len() {
                let from = (image * rows + y * self.stride) * columns;
                let to = (image * height + self.first[0] + y * self.step) * width + self.first[1];
                let offset = |x| [(from + x * self.stride) * self.source[2], (to + x * self.step) * channels];
                offsets.extend((0..self.pixels[1]).map(offset));
            }
        }
    }

    /// Length of a tile's output. The outputs of successive tiles follow each other.
    fn tile_output(&self, tile: &Tile) -> usize {
        let [height, width, channels] = self.output;
        let end = if tile.rows.end == self.pixels[0] { height } else { tile.rows.end * self.step };
        tile.images.len() * (end - tile.rows.start * self.step) * width * channels
    }
}

/// Copies a range of columns into a zeroed panel, `[patch, width]`.
pub(super) type Pack<'a> = dyn Fn(Range<usize>, usize, &mut [f32]) + Sync + 'a;

/// Right-hand matrix, packed into panels in the order in which the micro-kernel reads them.
pub(super) struct Panels<'a> {
    pub(super) patch: usize,
    pub(super) columns: usize,
    pub(super) pack: &'a Pack<'a>,
    /// Bias of each column, or empty.
    pub(super) bias: &'a [f32],
    /// Slope of the rectifier; 1 disables it.
    pub(super) slope: f32,
}

/// A packed range of columns.
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

/// The window of a tile and the offsets of its pixels. Each thread reuses one.
#[derive(Default)]
pub(super) struct Scratch {
    pub(super) window: Vec<f32>,
    pub(super) offsets: Vec<[usize; 2]>,
}

impl Pass {
    /// Computes the positions of `output` that belong to this pass.
    pub(super) fn run(&self, batch: usize, source: &[f32], panels: &Panels, output: &mut [f32]) {
        let fewer_pixels = batch * self.window_len(self.pixels[0]) < self.patch() * panels.columns;
        if fewer_pixels && panels.columns > panel_columns() {
            self.by_panels(batch, source, panels, output);
        } else {
            self.by_tiles(batch, source, panels, output);
        }
    }

    /// Many pixels, few weights: each task computes one tile.
    fn by_tiles(&self, batch: usize, source: &[f32], panels: &Panels, output: &mut [f32]) {
        let packed: Vec<_> = panels.ranges().into_par_iter().map(|columns| panels.packed(columns)).collect();
        let mut rest = output;
        let mut tasks = Vec::new();
        for tile in self.tiles(batch) {
            let (part, others) = rest.split_at_mut(self.tile_output(&tile));
            tasks.push((tile, part));
            rest = others;
        }
        tasks.into_par_iter().for_each_init(Scratch::default, |scratch, (tile, output)| {
            self.fill(&tile, source, scratch);
            for panel in &packed {
                let output = &mut output[panel.columns.start..];
                self.product(&scratch.window, &scratch.offsets, panel, output);
            }
        });
    }

    /// Few pixels, many weights: each task packs and multiplies one panel.
    fn by_panels(&self, batch: usize, source: &[f32], panels: &Panels, output: &mut [f32]) {
        let mut scratch = Scratch::default();
        self.fill(&Tile { images: 0..batch, rows: 0..self.pixels[0] }, source, &mut scratch);
        let Scratch { window, offsets } = scratch;
        let product = |columns: Range<usize>| {
            let width = columns.len();
            let dense: Vec<_> = offsets.iter().enumerate().map(|(i, [from, _])| [*from, i * width]).collect();
            let mut result = vec![0.0; offsets.len() * width];
            self.product(&window, &dense, &panels.packed(columns.clone()), &mut result);
            (columns.start, result)
        };
        let results: Vec<_> = panels.ranges().into_par_iter().map(product).collect();
        for (column, result) in results {
            for ([_, to], result) in offsets.iter().zip(result.chunks_exact(result.len() / offsets.len())) {
                output[to + column..][..result.len()].copy_from_slice(result);
            }
        }
    }

    pub(super) fn fill(&self, tile: &Tile, source: &[f32], scratch: &mut Scratch) {
        self.fill_window(tile, source, &mut scratch.window);
        self.fill_offsets(tile, &mut scratch.offsets);
    }

    fn product(&self, window: &[f32], offsets: &[[usize; 2]], panel: &Panel, output: &mut [f32]) {
        let product = Multiply {
            source: window,
            offsets,
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
