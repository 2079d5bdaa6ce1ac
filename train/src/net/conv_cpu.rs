//! The three passes of [`leaky_conv2d`](super::conv::leaky_conv2d) on the CPU.
//!
//! Tensors keep their channels last, so that a row of a patch is one contiguous run of memory. No patch is copied: images
//! are copied once into a window with room for the padding, from which the products read patches where they lie. With
//! `patch = kernel * kernel * in`, the passes are, all row-major,
//!
//! ```text
//! output   [pixels, out]  = patches [pixels, patch]  * weight [patch, out]
//! d weight [patch, out]   = patches^T [patch, pixels] * d output [pixels, out]
//! d input                 = for each remainder of the position divided by the stride, the taps of the kernel that meet
//!                           it make a convolution of stride 1 of d output, with in and out exchanged
//! ```
//!
//! Each element of a result is one sum in a fixed order, or a sum over parts that depend on the sizes alone: results are
//! bit-identical for any number of threads, and equal images get equal features wherever they lie in the batch.

use std::ops::Range;

use rayon::prelude::*;

use super::conv_simd::{Accumulate, Correlate, TAIL, lanes, panel_columns};

/// Elements of a window that leave room for a panel in a 1 MiB L2 cache.
const WINDOW: usize = 64 * 1024;
/// Fewest pixels worth a task of their own.
const PIXELS: usize = 192;
/// Rows of the weight's gradient that are summed together.
const PATCH_ROWS: usize = 96;
/// Tasks of a sum over the batch.
const TASKS: usize = 16;
/// Weights whose gradient is summed over parts of the batch.
const FEW_WEIGHTS: usize = 128 * 1024;

/// Sizes of one convolution with "same" padding `kernel / 2`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Geometry {
    batch: usize,
    height: usize,
    width: usize,
    channels: usize,
    out_channels: usize,
    kernel: usize,
    stride: usize,
}

impl Geometry {
    /// Sizes for an input `[batch, height, width, in]` and a weight `[kernel, kernel, in, out]`.
    pub(super) fn new(input: [usize; 4], weight: [usize; 4], stride: usize) -> Self {
        let [batch, height, width, channels] = input;
        let [kernel, kernel_width, weight_channels, out_channels] = weight;
        assert!(kernel == kernel_width && kernel % 2 == 1, "the kernel must be square and odd: {weight:?}");
        assert_eq!(channels, weight_channels, "input {input:?} and weight {weight:?} differ in channels");
        assert!(stride > 0 && !input.contains(&0) && !weight.contains(&0), "empty convolution");
        Self { batch, height, width, channels, out_channels, kernel, stride }
    }

    fn out_height(&self) -> usize {
        (self.height - 1) / self.stride + 1
    }

    fn out_width(&self) -> usize {
        (self.width - 1) / self.stride + 1
    }

    /// Shape of the output `[batch, height, width, out]`.
    pub(super) fn output(&self) -> [usize; 4] {
        [self.batch, self.out_height(), self.out_width(), self.out_channels]
    }

    fn patch(&self) -> usize {
        self.kernel * self.kernel * self.channels
    }

    /// The forward pass.
    fn forward(&self) -> Correlation {
        let padding = -(self.kernel / 2).cast_signed();
        Correlation {
            source: [self.height, self.width, self.channels],
            begin: [padding; 2],
            pixels: [self.out_height(), self.out_width()],
            stride: self.stride,
            taps: [self.kernel; 2],
            output: [self.out_height(), self.out_width(), self.out_channels],
            first: [0; 2],
            step: 1,
        }
    }

    /// The part of the input's gradient at positions `first + stride * i`, and for each of its taps the tap of the kernel.
    fn backward(&self, first: [usize; 2]) -> (Correlation, Vec<[usize; 2]>) {
        let (size, padding) = ([self.height, self.width], self.kernel / 2);
        // Along either axis, tap k takes input position y to output position (y + padding - k) / stride if that is whole.
        let remainder = first.map(|y| (y + padding) % self.stride);
        let taps = remainder.map(|r| self.kernel.saturating_sub(r).div_ceil(self.stride));
        let tap = |axis: usize, i: usize| remainder[axis] + self.stride * (taps[axis] - 1 - i);
        let axis = |i: usize| {
            let last = ((first[i] + padding) / self.stride).cast_signed();
            (last + 1 - taps[i].cast_signed(), (size[i] - first[i]).div_ceil(self.stride))
        };
        let ((top, rows), (left, columns)) = (axis(0), axis(1));
        let correlation = Correlation {
            source: [self.out_height(), self.out_width(), self.out_channels],
            begin: [top, left],
            pixels: [rows, columns],
            stride: 1,
            taps,
            output: [self.height, self.width, self.channels],
            first,
            step: self.stride,
        };
        let taps = (0..taps[0]).flat_map(|y| (0..taps[1]).map(move |x| [tap(0, y), tap(1, x)])).collect();
        (correlation, taps)
    }
}

/// `output[first + step * i] = sum over taps of source[begin + stride * i + tap] * weight[tap]`, where the source is zero
/// outside. Sizes and positions are those of rows and columns; the third of a size is its channels.
#[derive(Clone, Copy, Debug)]
struct Correlation {
    source: [usize; 3],
    begin: [isize; 2],
    pixels: [usize; 2],
    stride: usize,
    taps: [usize; 2],
    output: [usize; 3],
    first: [usize; 2],
    step: usize,
}

/// Rows of pixels of some images; all their rows if there are several images.
#[derive(Clone, Debug)]
struct Section {
    images: Range<usize>,
    rows: Range<usize>,
}

impl Correlation {
    fn patch(&self) -> usize {
        self.taps[0] * self.run()
    }

    /// Elements of a row of a patch.
    fn run(&self) -> usize {
        self.taps[1] * self.source[2]
    }

    /// Rows and columns of the part of the source that `rows` rows of pixels see.
    fn window(&self, rows: usize) -> [usize; 2] {
        [(rows, 0), (self.pixels[1], 1)].map(|(pixels, axis)| (pixels - 1) * self.stride + self.taps[axis])
    }

    fn window_len(&self, rows: usize) -> usize {
        self.window(rows).iter().product::<usize>() * self.source[2]
    }

    /// The pixels of a batch in sections of about the size of a cache, in their order.
    fn sections(&self, batch: usize) -> Vec<Section> {
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

/// The right side of a product, packed in panels that the tiles read from front to end.
struct Panels<'a> {
    columns: usize,
    /// Packs columns `columns` into a `[patch, width]` panel of zeros.
    pack: &'a (dyn Fn(Range<usize>, usize, &mut [f32]) + Sync),
    patch: usize,
    bias: &'a [f32],
    slope: f32,
}

/// A panel and the bias of its columns.
struct Panel {
    columns: Range<usize>,
    values: Vec<f32>,
    bias: Vec<f32>,
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
        Panel { columns, values, bias }
    }
}

/// A window on a section's source, and the places of its pixels: memory that a thread uses again.
#[derive(Default)]
struct Scratch {
    window: Vec<f32>,
    places: Vec<[usize; 2]>,
}

impl Correlation {
    /// Computes the positions of `output` that are this correlation's.
    fn run_over(&self, batch: usize, source: &[f32], panels: &Panels, output: &mut [f32]) {
        if self.patch() == 0 {
            return;
        }
        let ranges = panels.ranges();
        let whole = Section { images: 0..batch, rows: 0..self.pixels[0] };
        if batch * self.window_len(self.pixels[0]) < self.patch() * panels.columns && ranges.len() > 1 {
            // Few pixels, many weights: each task takes a panel, packs it, and is done with it.
            let mut scratch = Scratch::default();
            self.fill(&whole, source, &mut scratch);
            let results: Vec<_> = ranges
                .into_par_iter()
                .map(|columns| {
                    let panel = panels.packed(columns);
                    let width = panel.columns.len();
                    let mut result = vec![0.0; scratch.places.len() * width];
                    let places: Vec<_> =
                        scratch.places.iter().enumerate().map(|(i, place)| [place[0], i * width]).collect();
                    self.product(&scratch.window, &places, &panel, panels.slope, (&mut result, 0));
                    (panel.columns, result)
                })
                .collect();
            for (columns, result) in results {
                for (place, result) in scratch.places.iter().zip(result.chunks_exact(columns.len())) {
                    output[place[1] + columns.start..][..result.len()].copy_from_slice(result);
                }
            }
            return;
        }
        let packed: Vec<_> = ranges.into_par_iter().map(|columns| panels.packed(columns)).collect();
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
                let output = (&mut *output, panel.columns.start);
                self.product(&scratch.window, &scratch.places, panel, panels.slope, output);
            }
        });
    }

    fn fill(&self, section: &Section, source: &[f32], scratch: &mut Scratch) {
        self.fill_window(section, source, &mut scratch.window);
        self.fill_places(section, &mut scratch.places);
    }

    fn product(
        &self,
        window: &[f32],
        places: &[[usize; 2]],
        panel: &Panel,
        slope: f32,
        (output, column): (&mut [f32], usize),
    ) {
        let correlate = Correlate {
            source: window,
            places,
            run: self.run(),
            row_step: self.window(1)[1] * self.source[2],
            panel: &panel.values,
            patch: self.patch(),
            bias: &panel.bias,
            slope,
            output: &mut output[column..],
            columns: panel.columns.len(),
        };
        correlate.run();
    }
}

/// `leaky(conv(input, weight) + bias)`.
pub(super) fn forward(g: &Geometry, input: &[f32], weight: &[f32], bias: &[f32], slope: f32) -> Vec<f32> {
    let out = g.out_channels;
    let pack = |columns: Range<usize>, width: usize, panel: &mut [f32]| {
        for (to, from) in panel.chunks_exact_mut(width).zip(weight.chunks_exact(out)) {
            to[..columns.len()].copy_from_slice(&from[columns.clone()]);
        }
    };
    let panels = Panels { columns: out, pack: &pack, patch: g.patch(), bias, slope };
    let mut output = vec![0.0; g.output().iter().product()];
    g.forward().run_over(g.batch, input, &panels, &mut output);
    output
}

/// Turns the gradient of the output into the gradient of what the rectifier saw, in place, and returns the gradient
/// of the bias. A slope in 0..1 keeps signs, so the output tells on which side each value was. (Without branches, so that
/// the loops become vector instructions.)
pub(super) fn rectifier_gradient(g: &Geometry, output: &[f32], slope: f32, gradient: &mut [f32]) -> Vec<f32> {
    let out = g.out_channels;
    assert_eq!(gradient.len(), output.len());
    let length = (gradient.len() / out).div_ceil(TASKS) * out;
    let partial = |(gradient, output): (&mut [f32], &[f32])| {
        let mut sums = vec![0.0; out];
        for (gradient, output) in gradient.chunks_exact_mut(out).zip(output.chunks_exact(out)) {
            for ((gradient, output), sum) in gradient.iter_mut().zip(output).zip(&mut sums) {
                *gradient *= slope.max(f32::from(*output > 0.0));
                *sum += *gradient;
            }
        }
        sums
    };
    let partials: Vec<_> =
        gradient.par_chunks_mut(length).zip(output.par_chunks(length)).map(partial).collect();
    let mut bias = vec![0.0; out];
    partials.iter().for_each(|partial| add(&mut bias, partial));
    bias
}

/// Gradient of the input, from the `gradient` of the output before the rectifier.
pub(super) fn input_gradient(g: &Geometry, weight: &[f32], gradient: &[f32]) -> Vec<f32> {
    let (channels, out) = (g.channels, g.out_channels);
    let mut input = vec![0.0; g.batch * g.height * g.width * channels];
    for y in 0..g.stride.min(g.height) {
        for x in 0..g.stride.min(g.width) {
            let (correlation, taps) = g.backward([y, x]);
            let pack = |columns: Range<usize>, width: usize, panel: &mut [f32]| {
                for (to, [ky, kx]) in panel.chunks_exact_mut(out * width).zip(&taps) {
                    let from = &weight[(ky * g.kernel + kx) * channels * out..][..channels * out];
                    for (i, from) in
                        from.chunks_exact(out).skip(columns.start).take(columns.len()).enumerate()
                    {
                        to[i..].iter_mut().step_by(width).zip(from).for_each(|(to, from)| *to = *from);
                    }
                }
            };
            let patch = correlation.patch();
            let panels = Panels { columns: channels, pack: &pack, patch, bias: &[], slope: 1.0 };
            correlation.run_over(g.batch, gradient, &panels, &mut input);
        }
    }
    input
}

/// Gradient of the weight, from the `gradient` of the output before the rectifier.
pub(super) fn weight_gradient(g: &Geometry, input: &[f32], gradient: &[f32]) -> Vec<f32> {
    let (out, correlation) = (g.out_channels, g.forward());
    let run = correlation.run();
    let blocks: Vec<_> = (0..g.patch())
        .step_by(run)
        .flat_map(|y| (y..y + run).step_by(PATCH_ROWS).map(move |row| row..(row + PATCH_ROWS).min(y + run)))
        .collect();
    let sections = correlation.sections(g.batch);
    let row_step = correlation.window(1)[1] * g.channels;
    let accumulate = |scratch: &Scratch, section: &Section, block: &Range<usize>, sums: &mut [f32]| {
        let first = (section.images.start * g.out_height() + section.rows.start) * g.out_width();
        let accumulate = Accumulate {
            source: &scratch.window[block.start / run * row_step + block.start % run..],
            places: &scratch.places,
            gradient: &gradient[first * out..],
            sums,
            columns: out,
        };
        accumulate.run();
    };
    let mut weight = vec![0.0; g.patch() * out];
    if weight.len() <= FEW_WEIGHTS && sections.len() >= TASKS {
        // Many pixels, few weights: each task takes some of the pixels.
        let partials: Vec<_> = sections
            .par_chunks(sections.len().div_ceil(TASKS))
            .map_init(Scratch::default, |scratch, sections| {
                let mut sums = vec![0.0; g.patch() * out];
                for section in sections {
                    correlation.fill(section, input, scratch);
                    for block in &blocks {
                        accumulate(scratch, section, block, &mut sums[block.start * out..block.end * out]);
                    }
                }
                sums
            })
            .collect();
        weight.par_chunks_mut(out * PATCH_ROWS).enumerate().for_each(|(i, part)| {
            partials.iter().for_each(|partial| add(part, &partial[i * out * PATCH_ROWS..]));
        });
        return weight;
    }
    // Few pixels, many weights: each task takes some of the weights.
    let mut tasks = Vec::new();
    let mut rest = weight.as_mut_slice();
    for block in &blocks {
        let (part, others) = rest.split_at_mut(block.len() * out);
        tasks.push((block, part));
        rest = others;
    }
    tasks.into_par_iter().for_each_init(Scratch::default, |scratch, (block, part)| {
        for section in &sections {
            correlation.fill(section, input, scratch);
            accumulate(scratch, section, block, part);
        }
    });
    weight
}

fn add(sums: &mut [f32], values: &[f32]) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
}
