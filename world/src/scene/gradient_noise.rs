//! Gradient noise (K. Perlin, "Improving Noise", SIGGRAPH 2002) in octaves, with gradients from a hash of the lattice point.
//!
//! An octave fades out before pixels become too coarse for it. From far away, the camera sees the mean color and no moiré.

use crate::hash::{hash, signed};
use nalgebra::{Vector3, Vector4};

/// Number of octaves. Each has half the grain and half the amplitude of the one before.
const OCTAVES: usize = 3;
/// Scales the sum of the octaves, with its standard deviation of 0.2, to use the range `[-1, 1]`.
const GAIN: f64 = 2.5;
/// Pixel sizes, in units of the grain, at which an octave begins to fade and at which it is gone. Its shortest waves are about as
/// long as the grain, and a wave must be longer than two pixels to be sampled.
const FADE: [f64; 2] = [0.3, 0.8];

/// A number at which neighboring `f64` are 1 apart, so that a sum with it is an integer.
const BIAS: f64 = 1.5 * (1_u64 << 52) as f64;

/// Gradient noise in octaves, with grain 1.
pub(crate) struct GradientNoise {
    octaves: [Octave; OCTAVES],
}

impl GradientNoise {
    /// Creates the pattern of a seed.
    pub(crate) fn new(seed: u64) -> Self {
        Self { octaves: std::array::from_fn(|i| Octave::new(hash(hash(seed).wrapping_add(i as u64)))) }
    }

    /// Returns the value at a place, in `[-1, 1]`, filtered for pixels of the given size. A size of NaN, as on a surface seen
    /// edge-on, removes the pattern.
    pub(crate) fn at(&mut self, place: &Vector3<f64>, pixel: f64) -> f64 {
        let (mut sum, mut scale) = (0.0, 1.0);
        for octave in &mut self.octaves {
            let share = ((FADE[1] - scale * pixel) / (FADE[1] - FADE[0])).clamp(0.0, 1.0);
            if share > 0.0 {
                sum += share / scale * octave.at(&(place * scale));
            }
            scale *= 2.0;
        }
        // Approaches the bounds smoothly.
        let bounded = (GAIN * sum).clamp(-1.0, 1.0);
        bounded * (1.5 - 0.5 * bounded * bounded)
    }
}

/// Gradient noise on the integer lattice. Successive queries in the same cell are fast.
struct Octave {
    seed: u64,
    /// Offset of the lattice. The noise is 0 at lattice points, so they should not coincide with a special place.
    offset: Vector3<f64>,
    /// Cell of the last query, as the bits of [`BIAS`] plus its integer coordinates.
    cell: Vector3<u64>,
    /// Linear function of the place in the cell, for each of its corners: gradient, and value at 0.
    corners: [Vector4<f64>; 8],
}

impl Octave {
    fn new(seed: u64) -> Self {
        let offset = signed(seed).into();
        let mut octave = Self { seed, offset, cell: Vector3::zeros(), corners: [Vector4::zeros(); 8] };
        octave.enter(Vector3::zeros());
        octave
    }

    /// Computes the corners of a cell.
    fn enter(&mut self, cell: Vector3<u64>) {
        self.cell = cell;
        for (i, corner) in self.corners.iter_mut().enumerate() {
            let aside = [i & 1, i >> 1 & 1, i >> 2];
            let mut bits = self.seed;
            for (axis, odd) in [0x8cb9_2ba7_2f3d_8dd7, 0xd6e8_feb8_6659_fd93, 0xa076_1d64_78bd_642f_u64]
                .into_iter()
                .enumerate()
            {
                bits = bits.wrapping_add(cell[axis].wrapping_add(aside[axis] as u64).wrapping_mul(odd));
            }
            let [x, y, z] = signed(hash(bits));
            let [a, b, c] = aside.map(|a| a as f64);
            *corner = Vector4::new(x, y, z, -(x * a + y * b + z * c));
        }
    }

    fn at(&mut self, place: &Vector3<f64>) -> f64 {
        let place = place + self.offset;
        // The sum is `place` rounded down. An integer may select either of the two cells that it borders, which agree there.
        let biased = place.add_scalar(-0.5).add_scalar(BIAS);
        let cell = biased.map(f64::to_bits);
        if cell != self.cell {
            self.enter(cell);
        }
        let t = place - biased.add_scalar(-BIAS);
        let share = t.map(|t| t * t * t * (t * (t * 6.0 - 15.0) + 10.0));
        let between = |a: Vector4<f64>, b: Vector4<f64>, share: f64| a + (b - a) * share;
        let [a, b, c, d, e, f, g, h] = self.corners;
        let near = between(between(a, b, share.x), between(c, d, share.x), share.y);
        let far = between(between(e, f, share.x), between(g, h, share.x), share.y);
        between(near, far, share.z).dot(&t.push(1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_as_coarse_as_the_grain_show_the_mean() {
        let at = |pixel| GradientNoise::new(4).at(&Vector3::new(0.3, 12.6, -3.1), pixel);
        let differ = |a: f64, b: f64| (at(a) - at(b)).abs() > 1e-9;
        assert!(!differ(0.0, 0.01) && differ(0.0, 0.2) && differ(0.0, FADE[1]));
        assert!([FADE[1], f64::INFINITY, f64::NAN].into_iter().all(|pixel| at(pixel).abs() < 1e-12));
    }
}
