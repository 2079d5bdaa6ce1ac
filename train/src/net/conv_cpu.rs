//! The arithmetic of [`leaky_conv2d`](super::conv::leaky_conv2d) on the CPU: patches gathered into a tile that stays
//! in the cache, one matrix product a tile, threads over tiles.
//!
//! Tensors keep their channels last, so that a row of a patch is one contiguous run of memory, an output tile is one
//! contiguous slice, and a tile can span images (small maps would starve the product otherwise). With
//! `patch = kernel * kernel * in`, the three passes are, all row-major,
//!
//! ```text
//! output  [pixels, out]   = patches  [pixels, patch]  * weight^T  [patch, out]
//! d input [pixels, patch] = d output [pixels, out]    * weight    [out, patch], added back where each patch came from
//! d weight   [out, patch] = d output^T [out, pixels]  * patches   [pixels, patch]
//! ```
//!
//! Every partition depends on the sizes alone and partial sums are added in a fixed order: results are bit-identical
//! for any number of threads.
#![allow(unsafe_code)]

use std::ops::Range;

use gemm::Parallelism;
use rayon::prelude::*;

/// Elements of a tile of patches: a quarter of a 1 MiB L2 cache.
const TILE: usize = 64 * 1024;
/// Fewest pixels worth a matrix product.
const TILE_PIXELS: usize = 64;
/// Longest sum inside one product. `gemm` splits longer ones by a rule that looks at the other sizes too, and two
/// equal images must get equal features wherever they lie in the batch.
const DEPTH: usize = 512;
/// The weight gradient is summed over at most this many chunks of the batch, of at least [`CHUNK_PIXELS`] pixels.
const CHUNKS: usize = 16;
const CHUNK_PIXELS: usize = 256;

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
    /// Sizes for an input `[batch, height, width, in]` and a weight `[out, kernel, kernel, in]`.
    pub(super) fn new(input: [usize; 4], weight: [usize; 4], stride: usize) -> Self {
        let [batch, height, width, channels] = input;
        let [out_channels, kernel, kernel_width, weight_channels] = weight;
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

    /// Output rows of the whole batch, the unit in which the work is divided.
    fn rows(&self) -> usize {
        self.batch * self.out_height()
    }

    /// Elements of one row of the kernel over all channels: contiguous in the input.
    fn run(&self) -> usize {
        self.kernel * self.channels
    }

    fn patch(&self) -> usize {
        self.kernel * self.run()
    }

    /// Output rows of a tile whose pixels have `elements` each.
    fn tile_rows(&self, elements: usize) -> usize {
        let pixels = (TILE / elements).max(TILE_PIXELS);
        // Even, so that a tile never ends in a single pixel: a product with a vector sums in another order.
        (pixels / self.out_width()).max(1).next_multiple_of(2)
    }

    /// The piece of the input that row `ky` of the kernel reads at `pixel` of output row `row`: the position in the
    /// run where it begins, and its range in the input. `None` if it lies in the padding.
    fn piece(&self, row: usize, pixel: usize, ky: usize) -> Option<(usize, Range<usize>)> {
        let padding = self.kernel / 2;
        let (image, out_y) = (row / self.out_height(), row % self.out_height());
        let y = (out_y * self.stride + ky).checked_sub(padding).filter(|&y| y < self.height)?;
        let left = pixel * self.stride;
        let skipped = padding.saturating_sub(left);
        let (begin, end) = ((left + skipped) - padding, (left + self.kernel - padding).min(self.width));
        let line = (image * self.height + y) * self.width;
        Some((skipped * self.channels, (line + begin) * self.channels..(line + end) * self.channels))
    }

    /// Gathers the patches of output rows `rows`, of each only the kernel rows `taps`, one after the other.
    fn gather(&self, input: &[f32], rows: Range<usize>, taps: Range<usize>, patches: &mut [f32]) {
        let mut runs = patches.chunks_exact_mut(self.run());
        for row in rows {
            for pixel in 0..self.out_width() {
                for (ky, run) in taps.clone().zip(&mut runs) {
                    match self.piece(row, pixel, ky) {
                        Some((at, from)) => {
                            let to = at + from.len();
                            run[..at].fill(0.0);
                            run[at..to].copy_from_slice(&input[from]);
                            run[to..].fill(0.0);
                        }
                        None => run.fill(0.0),
                    }
                }
            }
        }
    }

    /// Adds the patches of output rows `rows` back to where [`gather`](Self::gather) would have read them. `input`
    /// begins at input element `origin`.
    fn scatter(&self, patches: &[f32], rows: Range<usize>, origin: usize, input: &mut [f32]) {
        let mut runs = patches.chunks_exact(self.run());
        for row in rows {
            for pixel in 0..self.out_width() {
                for (ky, run) in (0..self.kernel).zip(&mut runs) {
                    if let Some((at, to)) = self.piece(row, pixel, ky) {
                        let target = &mut input[to.start - origin..to.end - origin];
                        for (sum, value) in target.iter_mut().zip(&run[at..]) {
                            *sum += value;
                        }
                    }
                }
            }
        }
    }
}

/// `leaky(conv(input, weight) + bias)`.
pub(super) fn forward(g: &Geometry, input: &[f32], weight: &[f32], bias: &[f32], slope: f32) -> Vec<f32> {
    let (patch, out, pixels_a_row) = (g.patch(), g.out_channels, g.out_width());
    let weight = transposed(weight, out, patch);
    let tile_rows = g.tile_rows(patch);
    let depth = patch.div_ceil(patch.div_ceil(DEPTH));
    let mut output = vec![0.0; g.rows() * pixels_a_row * out];
    output.par_chunks_mut(tile_rows * pixels_a_row * out).enumerate().for_each_init(
        Vec::new,
        |patches, (i, tile)| {
            let pixels = tile.len() / out;
            let rows = i * tile_rows..i * tile_rows + pixels / pixels_a_row;
            patches.resize(pixels * patch, 0.0);
            g.gather(input, rows, 0..g.kernel, patches);
            tile.chunks_exact_mut(out).for_each(|pixel| pixel.copy_from_slice(bias));
            for begin in (0..patch).step_by(depth) {
                let length = depth.min(patch - begin);
                let lhs = Lhs { data: &patches[begin..], strides: [patch, 1], rows: pixels, depth: length };
                add_product(tile, &lhs, &weight[begin * out..(begin + length) * out]);
            }
            for value in tile {
                *value = value.max(slope * *value);
            }
        },
    );
    output
}

/// Turns the gradient of the output into the gradient of what the rectifier saw, in place, and returns the gradient
/// of the bias. A slope in 0..1 keeps signs, so the output tells on which side each value was. (Without branches, so that
/// the loops become vector instructions.)
pub(super) fn rectifier_gradient(g: &Geometry, output: &[f32], slope: f32, gradient: &mut [f32]) -> Vec<f32> {
    let out = g.out_channels;
    assert_eq!(gradient.len(), output.len());
    let length = (gradient.len() / out).div_ceil(CHUNKS) * out;
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
    in_order(&partials)
}

/// Gradient of the input, from the `gradient` of the output before the rectifier.
pub(super) fn input_gradient(g: &Geometry, weight: &[f32], gradient: &[f32]) -> Vec<f32> {
    let (patch, out, pixels_a_row) = (g.patch(), g.out_channels, g.out_width());
    let image = g.height * g.width * g.channels;
    let images = TILE_PIXELS.div_ceil(g.out_height() * pixels_a_row);
    let tile_rows = g.tile_rows(patch);
    let mut input = vec![0.0; g.batch * image];
    input.par_chunks_mut(images * image).enumerate().for_each_init(Vec::new, |patches, (i, input)| {
        let first = i * images * g.out_height();
        let end = first + input.len() / image * g.out_height();
        for row in (first..end).step_by(tile_rows) {
            let rows = row..(row + tile_rows).min(end);
            let pixels = rows.len() * pixels_a_row;
            patches.clear();
            patches.resize(pixels * patch, 0.0);
            let data = &gradient[row * pixels_a_row * out..];
            add_product(patches, &Lhs { data, strides: [out, 1], rows: pixels, depth: out }, weight);
            g.scatter(patches, rows, i * images * image, input);
        }
    });
    input
}

/// Gradient of the weight, from the `gradient` of the output before the rectifier.
pub(super) fn weight_gradient(g: &Geometry, input: &[f32], gradient: &[f32]) -> Vec<f32> {
    let (run, out, pixels_a_row) = (g.run(), g.out_channels, g.out_width());
    let chunks = (g.rows() * pixels_a_row / CHUNK_PIXELS).clamp(1, CHUNKS);
    let chunk_rows = g.rows().div_ceil(chunks);
    // One task is a chunk of the batch and one row of the kernel: enough tasks for the small maps, too.
    let partial = |task: usize| {
        let (chunk, ky) = (task / g.kernel, task % g.kernel);
        let end = ((chunk + 1) * chunk_rows).min(g.rows());
        let mut sum = vec![0.0; out * run];
        let mut patches = Vec::new();
        for row in (chunk * chunk_rows..end).step_by(g.tile_rows(run)) {
            let rows = row..(row + g.tile_rows(run)).min(end);
            let pixels = rows.len() * pixels_a_row;
            patches.resize(pixels * run, 0.0);
            g.gather(input, rows, ky..ky + 1, &mut patches);
            let data = &gradient[row * pixels_a_row * out..];
            add_product(&mut sum, &Lhs { data, strides: [1, out], rows: out, depth: pixels }, &patches);
        }
        sum
    };
    let partials: Vec<_> =
        (0..g.rows().div_ceil(chunk_rows) * g.kernel).into_par_iter().map(partial).collect();
    let mut weight = vec![0.0; out * g.patch()];
    weight.par_chunks_mut(run).enumerate().for_each(|(i, sum)| {
        let (channel, ky) = (i / g.kernel, i % g.kernel);
        for partial in partials.iter().skip(ky).step_by(g.kernel) {
            for (sum, value) in sum.iter_mut().zip(&partial[channel * run..]) {
                *sum += value;
            }
        }
    });
    weight
}

fn in_order(partials: &[Vec<f32>]) -> Vec<f32> {
    let mut total = vec![0.0; partials.first().map_or(0, Vec::len)];
    for partial in partials {
        for (sum, value) in total.iter_mut().zip(partial) {
            *sum += value;
        }
    }
    total
}

/// The transpose of a row-major `[rows, columns]` matrix, in blocks that fit the cache.
fn transposed(matrix: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    const BLOCK: usize = 16;
    let mut result = vec![0.0; rows * columns];
    result.par_chunks_mut(BLOCK * rows).enumerate().for_each(|(block, lines)| {
        for begin in (0..rows).step_by(BLOCK) {
            for (i, line) in lines.chunks_exact_mut(rows).enumerate() {
                for (row, value) in (begin..rows).zip(&mut line[begin..(begin + BLOCK).min(rows)]) {
                    *value = matrix[row * columns + block * BLOCK + i];
                }
            }
        }
    });
    result
}

/// The left factor of a product, a strided `[rows, depth]` matrix.
struct Lhs<'a> {
    data: &'a [f32],
    /// Distance in memory of neighbors in a column and in a row.
    strides: [usize; 2],
    rows: usize,
    depth: usize,
}

/// `sum += lhs * rhs` on this thread; `sum` and `rhs` are row-major.
fn add_product(sum: &mut [f32], lhs: &Lhs, rhs: &[f32]) {
    let (rows, depth) = (lhs.rows, lhs.depth);
    assert!(rows > 0 && depth > 0);
    let columns = sum.len() / rows;
    assert_eq!(sum.len(), rows * columns);
    assert_eq!(rhs.len(), depth * columns);
    assert!((rows - 1) * lhs.strides[0] + (depth - 1) * lhs.strides[1] < lhs.data.len());
    let [row_stride, column_stride] = lhs.strides.map(usize::cast_signed);
    let line = columns.cast_signed();
    // SAFETY: the assertions above bound every index that `gemm` forms: `sum` is exactly rows x columns and `rhs`
    // depth x columns, both dense, and the last element of `lhs` lies inside its slice. `sum` is borrowed mutably, so
    // it overlaps neither factor.
    unsafe {
        gemm::gemm(
            rows,
            columns,
            depth,
            sum.as_mut_ptr(),
            1,
            line,
            true,
            lhs.data.as_ptr(),
            column_stride,
            row_stride,
            rhs.as_ptr(),
            1,
            line,
            1.0,
            1.0,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}
