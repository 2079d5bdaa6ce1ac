//! Micro-kernels of the convolution on the CPU: two matrix products, each with a tile of sums that stays in registers.
//!
//! Each left-hand element is broadcast and multiplied with two vectors of the right-hand matrix. Twelve rows of that keep
//! the arithmetic units of a core busy without loading anything twice. [`pulp`] picks the widest vectors of the machine at
//! run time.

// Only code that is inlined into the dispatched function is compiled for the machine's vector instructions.
#![allow(clippy::inline_always)]

use pulp::{Arch, Simd, WithSimd};

/// Vectors per row of a register tile.
const VECTORS: usize = 2;
/// Pixels per block of the outer products, chosen so that the data they touch stays in the L1 cache.
const PIXELS: usize = 128;

/// Extra elements of any value at the end of a source: the last register tile of a run reads beyond its end.
pub(super) const TAIL: usize = 12;

/// Returns the columns of a panel, the unit in which the right-hand matrix is packed.
pub(super) fn panel_columns() -> usize {
    VECTORS * lanes()
}

/// Returns the elements of a vector on this machine.
pub(super) fn lanes() -> usize {
    struct Lanes;
    impl WithSimd for Lanes {
        type Output = usize;
        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> usize {
            S::F32_LANES
        }
    }
    Arch::new().dispatch(Lanes)
}

/// `leaky_relu(bias + patches * panel)` for some pixels.
pub(super) struct Multiply<'a> {
    pub(super) source: &'a [f32],
    /// Per pixel: offset of its patch in the source, and of its result in the output.
    pub(super) offsets: &'a [[usize; 2]],
    /// Elements of a row of a patch, contiguous in the source.
    pub(super) run: usize,
    /// Elements of the source from one row of a patch to the next.
    pub(super) row_step: usize,
    /// `[patch, columns]`, one or two vectors wide. Columns beyond the output are zero.
    pub(super) panel: &'a [f32],
    pub(super) patch: usize,
    /// One value per column of the panel.
    pub(super) bias: &'a [f32],
    /// Slope of the rectifier; 1 disables it.
    pub(super) slope: f32,
    pub(super) output: &'a mut [f32],
    /// Columns of the panel that belong to the output.
    pub(super) columns: usize,
}

impl Multiply<'_> {
    pub(super) fn run(self) {
        Arch::new().dispatch(self);
    }

    #[inline(always)]
    fn tiles<S: Simd, const ROWS: usize, const N: usize>(self, simd: S) {
        let (panel, _) = S::as_simd_f32s(self.panel).0.as_chunks::<N>();
        let (bias, slope) = (load::<S, N>(simd, self.bias), simd.splat_f32s(self.slope));
        for offsets in self.offsets.chunks(ROWS) {
            let mut sums = [bias; ROWS];
            for (y, panel) in panel.chunks_exact(self.run).enumerate() {
                let mut rows: [&[f32]; ROWS] = [&[]; ROWS];
                for (i, row) in rows.iter_mut().enumerate() {
                    // A tile with fewer pixels computes its last pixel several times.
                    let [begin, _] = offsets[i.min(offsets.len() - 1)];
                    *row = &self.source[begin + y * self.row_step..][..self.run];
                }
                sums = add_products(simd, rows, panel, sums);
            }
            for (&[_, at], mut sums) in offsets.iter().zip(sums) {
                for sum in &mut sums {
                    *sum = simd.max_f32s(*sum, simd.mul_f32s(*sum, slope));
                }
                store(simd, &mut self.output[at..at + self.columns], sums);
            }
        }
    }
}

/// `sums[i] + sum over t of rows[i][t] * panel[t]`
#[inline(always)]
fn add_products<S: Simd, const ROWS: usize, const N: usize>(
    simd: S,
    mut rows: [&[f32]; ROWS],
    panel: &[[S::f32s; N]],
    mut sums: [[S::f32s; N]; ROWS],
) -> [[S::f32s; N]; ROWS] {
    for row in &mut rows {
        // Repeats the length, so that the compiler can drop the bounds checks.
        *row = &row[..panel.len()];
    }
    for (t, panel) in panel.iter().enumerate() {
        for i in 0..ROWS {
            let element = simd.splat_f32s(rows[i][t]);
            for v in 0..N {
                sums[i][v] = simd.mul_add_e_f32s(element, panel[v], sums[i][v]);
            }
        }
    }
    sums
}

impl WithSimd for Multiply<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let vectors = self.panel.len() / self.patch / S::F32_LANES;
        match (vectors, S::REGISTER_COUNT >= 32) {
            (1, true) => self.tiles::<S, 12, 1>(simd),
            (1, false) => self.tiles::<S, 8, 1>(simd),
            (_, true) => self.tiles::<S, 12, VECTORS>(simd),
            (_, false) => self.tiles::<S, 5, VECTORS>(simd),
        }
    }
}

/// `sums += patches^T * gradient`, for one run of each patch.
pub(super) struct OuterProducts<'a> {
    /// Ends with a [`TAIL`].
    pub(super) source: &'a [f32],
    /// Per pixel: offset of its run in the source, and of its columns in the gradient.
    pub(super) offsets: &'a [[usize; 2]],
    pub(super) gradient: &'a [f32],
    /// `[run, columns]`.
    pub(super) sums: &'a mut [f32],
    pub(super) columns: usize,
}

impl OuterProducts<'_> {
    pub(super) fn run(self) {
        Arch::new().dispatch(self);
    }

    /// Computes the columns from `column` on, as many as the tile is wide.
    #[inline(always)]
    fn tiles<S: Simd, const ROWS: usize, const N: usize>(&mut self, simd: S, column: usize) {
        let width = (N * S::F32_LANES).min(self.columns - column);
        let run = self.sums.len() / self.columns;
        for offsets in self.offsets.chunks(PIXELS) {
            for first in (0..run).step_by(ROWS) {
                let rows = ROWS.min(run - first);
                let mut sums = [[simd.splat_f32s(0.0); N]; ROWS];
                for &[begin, at] in offsets {
                    let gradient = load(simd, &self.gradient[at + column..][..width]);
                    let run = self.source[begin + first..].first_chunk();
                    add_outer(simd, run.expect("a source ends with a tail"), gradient, &mut sums);
                }
                let lines = self.sums[first * self.columns..].chunks_mut(self.columns);
                for (line, mut sums) in lines.zip(sums).take(rows) {
                    let line = &mut line[column..column + width];
                    let before = load::<S, N>(simd, line);
                    for v in 0..N {
                        sums[v] = simd.add_f32s(before[v], sums[v]);
                    }
                    store(simd, line, sums);
                }
            }
        }
    }
}

/// Loads vectors, padded with zeros if there are fewer values.
#[inline(always)]
fn load<S: Simd, const N: usize>(simd: S, values: &[f32]) -> [S::f32s; N] {
    if let Some(vectors) = S::as_simd_f32s(values).0.first_chunk() {
        return *vectors;
    }
    let mut vectors = [simd.splat_f32s(0.0); N];
    for (vector, values) in vectors.iter_mut().zip(values.chunks(S::F32_LANES)) {
        *vector = simd.partial_load_f32s(values);
    }
    vectors
}

/// Stores as many elements of the vectors as `values` has room for.
#[inline(always)]
fn store<S: Simd, const N: usize>(simd: S, values: &mut [f32], vectors: [S::f32s; N]) {
    if let Some(values) = S::as_mut_simd_f32s(values).0.first_chunk_mut() {
        *values = vectors;
        return;
    }
    for (values, vector) in values.chunks_mut(S::F32_LANES).zip(vectors) {
        simd.partial_store_f32s(values, vector);
    }
}

#[inline(always)]
fn add_outer<S: Simd, const ROWS: usize, const N: usize>(
    simd: S,
    left: &[f32; ROWS],
    right: [S::f32s; N],
    sums: &mut [[S::f32s; N]; ROWS],
) {
    for i in 0..ROWS {
        let element = simd.splat_f32s(left[i]);
        for v in 0..N {
            sums[i][v] = simd.mul_add_e_f32s(element, right[v], sums[i][v]);
        }
    }
}

impl WithSimd for OuterProducts<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        for column in (0..self.columns).step_by(VECTORS * S::F32_LANES) {
            match (self.columns - column <= S::F32_LANES, S::REGISTER_COUNT >= 32) {
                (true, true) => self.tiles::<S, 12, 1>(simd, column),
                (true, false) => self.tiles::<S, 8, 1>(simd, column),
                (false, true) => self.tiles::<S, 12, VECTORS>(simd, column),
                (false, false) => self.tiles::<S, 5, VECTORS>(simd, column),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;
    use pulp::Scalar;

    use super::*;

    fn noise(len: usize, seed: f32) -> Vec<f32> {
        (0..len).map(|i| (seed + i as f32 * 1.37).sin()).collect()
    }

    /// Computes both products for seven pixels. Patches have two runs of five elements, eleven elements apart, and the
    /// output has three columns fewer than the register tile.
    fn products(lanes: usize, vectors: usize, simd: &dyn Fn(Product)) {
        let (width, columns) = (vectors * lanes, vectors * lanes - lanes.min(3));
        let (source, panel) = (noise(80 + TAIL, 0.1), noise(10 * width, 0.2));
        let (bias, gradient) = (noise(width, 0.3), noise(7 * columns, 0.4));
        let offsets: Vec<_> = (0..7).map(|i| [9 * i, i * columns]).collect();
        let (mut output, mut sums) = (vec![0.0; 7 * columns], noise(5 * columns, 0.5));
        let before = sums.clone();
        simd(Product::Multiply(Multiply {
            source: &source,
            offsets: &offsets,
            run: 5,
            row_step: 11,
            panel: &panel,
            patch: 10,
            bias: &bias,
            slope: 0.1,
            output: &mut output,
            columns,
        }));
        simd(Product::OuterProducts(OuterProducts {
            source: &source,
            offsets: &offsets,
            gradient: &gradient,
            sums: &mut sums,
            columns,
        }));
        for pixel in 0..7 {
            for column in 0..columns {
                let element = |t: usize| source[9 * pixel + t / 5 * 11 + t % 5];
                let sum: f32 = (0..10).map(|t| element(t) * panel[t * width + column]).sum();
                let sum = sum + bias[column];
                let expected = if sum > 0.0 { sum } else { 0.1 * sum };
                assert_relative_eq!(output[pixel * columns + column], expected, epsilon = 1e-5);
            }
        }
        for t in 0..5 {
            for column in 0..columns {
                let sum: f32 = (0..7).map(|p| source[9 * p + t] * gradient[p * columns + column]).sum();
                let at = t * columns + column;
                assert_relative_eq!(sums[at], before[at] + sum, epsilon = 1e-5);
            }
        }
    }

    /// Either product.
    enum Product<'a> {
        Multiply(Multiply<'a>),
        OuterProducts(OuterProducts<'a>),
    }

    impl WithSimd for Product<'_> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            match self {
                Self::Multiply(product) => product.with_simd(simd),
                Self::OuterProducts(product) => product.with_simd(simd),
            }
        }
    }

    #[test]
    fn every_instruction_set_of_this_machine_computes_the_same() {
        for vectors in [1, VECTORS] {
            products(lanes(), vectors, &|product| Arch::new().dispatch(product));
            products(1, vectors, &|product| Simd::vectorize(Scalar, product));
            #[cfg(target_arch = "x86_64")]
            if let Some(avx2) = pulp::x86::V3::try_new() {
                products(8, vectors, &|product| Simd::vectorize(avx2, product));
            }
        }
    }
}
