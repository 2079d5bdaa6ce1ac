//! The three passes of [`leaky_conv2d`](super::conv::leaky_conv2d) on the CPU.
//!
//! Tensors keep their channels last, so that a row of a patch is one contiguous run of memory. With
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

use super::conv_pass::{Panels, Pass, Scratch, Section};
use super::conv_simd::Accumulate;

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
    fn forward(&self) -> Pass {
        let padding = -(self.kernel / 2).cast_signed();
        Pass {
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
    fn backward(&self, first: [usize; 2]) -> (Pass, Vec<[usize; 2]>) {
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
        let pass = Pass {
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
        (pass, taps)
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
    let panels = Panels { patch: g.patch(), columns: out, pack: &pack, bias, slope };
    let mut output = vec![0.0; g.output().iter().product()];
    g.forward().run(g.batch, input, &panels, &mut output);
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
    for partial in &partials {
        add(&mut bias, partial);
    }
    bias
}

/// Gradient of the input, from the `gradient` of the output before the rectifier.
pub(super) fn input_gradient(g: &Geometry, weight: &[f32], gradient: &[f32]) -> Vec<f32> {
    let (channels, out) = (g.channels, g.out_channels);
    let mut input = vec![0.0; g.batch * g.height * g.width * channels];
    for y in 0..g.stride.min(g.height) {
        for x in 0..g.stride.min(g.width) {
            let (pass, taps) = g.backward([y, x]);
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
            // A stride beyond the kernel leaves positions that no output has seen.
            if !taps.is_empty() {
                let patch = pass.patch();
                let panels = Panels { patch, columns: channels, pack: &pack, bias: &[], slope: 1.0 };
                pass.run(g.batch, gradient, &panels, &mut input);
            }
        }
    }
    input
}

/// Gradient of the weight, from the `gradient` of the output before the rectifier.
pub(super) fn weight_gradient(g: &Geometry, input: &[f32], gradient: &[f32]) -> Vec<f32> {
    let (out, pass) = (g.out_channels, g.forward());
    let (run, row_step) = (pass.run_len(), pass.row_step());
    let blocks: Vec<_> = (0..g.patch())
        .step_by(run)
        .flat_map(|y| (y..y + run).step_by(PATCH_ROWS).map(move |row| row..(row + PATCH_ROWS).min(y + run)))
        .collect();
    let sections = pass.sections(g.batch);
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
                    pass.fill(section, input, scratch);
                    for block in &blocks {
                        accumulate(scratch, section, block, &mut sums[block.start * out..block.end * out]);
                    }
                }
                sums
            })
            .collect();
        weight.par_chunks_mut(out * PATCH_ROWS).enumerate().for_each(|(i, part)| {
            for partial in &partials {
                add(part, &partial[i * out * PATCH_ROWS..]);
            }
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
            pass.fill(section, input, scratch);
            accumulate(scratch, section, block, part);
        }
    });
    weight
}

fn add(sums: &mut [f32], values: &[f32]) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
}
