//! The forward and backward passes of [`leaky_conv2d`](super::leaky_conv::leaky_conv2d) on the CPU.
//!
//! Tensors are channels-last, so a row of a patch is one contiguous run of memory. With `patch = kernel * kernel * in`, the
//! passes are these products of row-major matrices:
//!
//! ```text
//! output   [pixels, out]  = patches [pixels, patch]  * weight [patch, out]
//! d weight [patch, out]   = patches^T [patch, pixels] * d output [pixels, out]
//! d input                 = for each phase (position modulo stride), a convolution of d output with stride 1, whose taps
//!                           are the taps of the kernel that reach the phase, with in and out exchanged
//! ```
//!
//! Every element of a result is one sum in a fixed order, or a sum over parts that depend on the sizes alone. Results are
//! therefore bit-identical for any number of threads, and equal images have equal features at any position in the batch.

use std::ops::Range;

use rayon::prelude::*;

use super::micro_kernel::OuterProducts;
use super::tiled_pass::{Panels, Pass, Scratch, Tile};

/// Rows of the weight's gradient per block.
const BLOCK_ROWS: usize = 96;
/// Parallel tasks of a sum over the batch.
const TASKS: usize = 16;
/// Maximum number of weights whose gradient is summed over parts of the batch.
const FEW_WEIGHTS: usize = 128 * 1024;

/// Sizes of a convolution with "same" padding, `kernel / 2`.
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
    /// Returns the sizes for an input `[batch, height, width, in]` and a weight `[kernel, kernel, in, out]`.
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

    /// Returns the shape of the output, `[batch, height, width, out]`.
    pub(super) fn output(&self) -> [usize; 4] {
        [self.batch, self.out_height(), self.out_width(), self.out_channels]
    }

    /// Elements of a patch.
    fn patch(&self) -> usize {
        self.kernel * self.kernel * self.channels
    }

    /// Returns the forward pass.
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

    /// Returns the pass that computes the input's gradient at positions `first + stride * i`, and the kernel tap that each
    /// of its taps stands for.
    fn backward(&self, first: [usize; 2]) -> (Pass, Vec<[usize; 2]>) {
        let (size, padding) = ([self.height, self.width], self.kernel / 2);
        // Along an axis, tap k connects input position y to output position (y + padding - k) / stride if that is whole.
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

/// Computes `leaky_relu(conv(input, weight) + bias)`.
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

/// Replaces the gradient of the rectifier's output with that of its input, in place. Returns the gradient of the bias.
///
/// A slope between 0 and 1 preserves signs, so the output shows the sign of the input. Written without branches, so that the
/// loops vectorize.
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

/// Computes the gradient of the input from the `gradient` before the rectifier.
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
            // A stride larger than the kernel leaves positions that no patch covers. Their gradient is zero.
            if !taps.is_empty() {
                let patch = pass.patch();
                let panels = Panels { patch, columns: channels, pack: &pack, bias: &[], slope: 1.0 };
                pass.run(g.batch, gradient, &panels, &mut input);
            }
        }
    }
    input
}

/// Computes the gradient of the weight from the `gradient` before the rectifier.
pub(super) fn weight_gradient(g: &Geometry, input: &[f32], gradient: &[f32]) -> Vec<f32> {
    let (out, pass) = (g.out_channels, g.forward());
    let (run, row_step) = (pass.run_len(), pass.row_step());
    let blocks: Vec<_> = (0..g.patch())
        .step_by(run)
        .flat_map(|y| (y..y + run).step_by(BLOCK_ROWS).map(move |row| row..(row + BLOCK_ROWS).min(y + run)))
        .collect();
    let tiles = pass.tiles(g.batch);
    let accumulate = |scratch: &Scratch, tile: &Tile, block: &Range<usize>, sums: &mut [f32]| {
        let first = (tile.images.start * g.out_height() + tile.rows.start) * g.out_width();
        let products = OuterProducts {
            source: &scratch.window[block.start / run * row_step + block.start % run..],
            offsets: &scratch.offsets,
            gradient: &gradient[first * out..],
            sums,
            columns: out,
        };
        products.run();
    };
    let mut weight = vec![0.0; g.patch() * out];
    if weight.len() <= FEW_WEIGHTS && tiles.len() >= TASKS {
        // Many pixels, few weights: each task takes some of the tiles.
        let partials: Vec<_> = tiles
            .par_chunks(tiles.len().div_ceil(TASKS))
            .map_init(Scratch::default, |scratch, tiles| {
                let mut sums = vec![0.0; g.patch() * out];
                for tile in tiles {
                    pass.fill(tile, input, scratch);
                    for block in &blocks {
                        accumulate(scratch, tile, block, &mut sums[block.start * out..block.end * out]);
                    }
                }
                sums
            })
            .collect();
        weight.par_chunks_mut(out * BLOCK_ROWS).enumerate().for_each(|(i, part)| {
            for partial in &partials {
                add(part, &partial[i * out * BLOCK_ROWS..]);
            }
        });
        return weight;
    }
    // Few pixels, many weights: each task takes one block of the weights.
    let mut tasks = Vec::new();
    let mut rest = weight.as_mut_slice();
    for block in &blocks {
        let (part, others) = rest.split_at_mut(block.len() * out);
        tasks.push((block, part));
        rest = others;
    }
    tasks.into_par_iter().for_each_init(Scratch::default, |scratch, (block, part)| {
        for tile in &tiles {
            pass.fill(tile, input, scratch);
            accumulate(scratch, tile, block, part);
        }
    });
    weight
}

fn add(sums: &mut [f32], values: &[f32]) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
}
