//! The [`correlation`](super::correlation) on the CPU, parallel over rows. Every sum is computed in an order that depends on
//! the sizes alone, so results are bit-identical for any number of threads.

// Only code that is inlined into the dispatched closure is compiled for the machine's vector instructions.
#![allow(clippy::inline_always)]

use pulp::Arch;
use rayon::prelude::*;

use super::displacement::{DISPLACEMENTS, REACH, SIDE, STRIDE};

/// Parallel sums of a dot product: the elements of the widest vector.
const LANES: usize = 16;

/// One of the two correlated maps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Side {
    First,
    Second,
}

/// The forward pass.
///
/// # Shapes
/// - `shape`: `[batch, height, width, channels]` of `a` and `b`
/// - result: `[batch, height, width, 441]`
pub(super) fn forward(shape: [usize; 4], a: &[f32], b: &[f32]) -> Vec<f32> {
    let [batch, height, width, channels] = shape;
    let mut output = vec![0.0; batch * height * width * DISPLACEMENTS];
    let rows = output.par_chunks_exact_mut(width * DISPLACEMENTS).enumerate();
    rows.for_each(|(row, output)| {
        Arch::new().dispatch(|| {
            for (x, output) in output.chunks_exact_mut(DISPLACEMENTS).enumerate() {
                let here = &a[(row * width + x) * channels..][..channels];
                for (displacement, there) in partners(shape, row, x) {
                    output[displacement] = dot(here, &b[there * channels..][..channels]) / channels as f32;
                }
            }
        });
    });
    output
}

/// The gradient with respect to the map on one side, given the map on the `other` side.
///
/// # Shapes
/// - `shape`: `[batch, height, width, channels]` of `other` and of the result
/// - `gradient`: `[batch, height, width, 441]`
pub(super) fn gradient(shape: [usize; 4], side: Side, gradient: &[f32], other: &[f32]) -> Vec<f32> {
    let [batch, height, width, channels] = shape;
    let mut output = vec![0.0; batch * height * width * channels];
    let rows = output.par_chunks_exact_mut(width * channels).enumerate();
    rows.for_each(|(row, output)| {
        Arch::new().dispatch(|| {
            for (x, output) in output.chunks_exact_mut(channels).enumerate() {
                for (displacement, there) in partners(shape, row, x) {
                    // Seen from the second map, a partner is displaced in the opposite direction.
                    let at = match side {
                        Side::First => (row * width + x) * DISPLACEMENTS + displacement,
                        Side::Second => there * DISPLACEMENTS + (DISPLACEMENTS - 1 - displacement),
                    };
                    let factor = gradient[at] / channels as f32;
                    for (sum, value) in output.iter_mut().zip(&other[there * channels..][..channels]) {
                        *sum += factor * value;
                    }
                }
            }
        });
    });
    output
}

/// Lists the displacements of a pixel that stay inside the map, with the pixels that they lead to. The pixel is column `x` of
/// row `row` of the whole batch.
#[inline(always)]
fn partners([_, height, width, _]: [usize; 4], row: usize, x: usize) -> impl Iterator<Item = (usize, usize)> {
    let (top, y) = (row - row % height, row % height);
    let columns = inside(x, width);
    inside(y, height)
        .flat_map(move |(i, y)| columns.clone().map(move |(j, x)| (i * SIDE + j, (top + y) * width + x)))
}

/// Lists the displacements along an axis that lead from `at` to a position below `size`, with that position.
#[inline(always)]
fn inside(at: usize, size: usize) -> impl Iterator<Item = (usize, usize)> + Clone {
    let first = REACH.saturating_sub(at / STRIDE);
    let last = SIDE.min(REACH + (size - 1 - at) / STRIDE + 1);
    (first..last).map(move |i| (i, at + i * STRIDE - REACH * STRIDE))
}

#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += a * b;
        }
    }
    let rest: f32 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f32>() + rest
}
