//! Textures: patterns in the matter of a body, as in wood or stone, which its surface cuts through. So one pattern serves all
//! shapes, has no seams, and looks the same from everywhere.
//!
//! The pattern is gradient noise (K. Perlin, "Improving Noise", SIGGRAPH 2002) in octaves, with gradients from a hash of the
//! place. An octave fades out before the camera's pixels get too coarse for it: from afar one sees the mean color and
//! no moiré.

use crate::hash::hash;
use crate::scene::Color;
use nalgebra::{Isometry3, Matrix3, Point3, Vector3, Vector4};
use serde::{Deserialize, Serialize};

/// Each has half the grain and half the amplitude of the one before.
const OCTAVES: usize = 3;
/// So that the pattern, whose octaves add up to a standard deviation of 0.2, makes use of `[-1, 1]`.
const GAIN: f64 = 2.5;
/// Pixels, in units of the grain, up to which an octave shows as it is, and from which on it does not show. Its shortest
/// waves are about as long as the grain, and what a pixel samples must be longer than two pixels.
const FADE: [f64; 2] = [0.3, 0.8];

/// Where the distance of neighboring `f64` is 1: a sum with it is whole.
const BIAS: f64 = 1.5 * (1_u64 << 52) as f64;

/// A pattern that makes a color brighter and darker.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Texture {
    /// Size of the pattern along the body's axes, above 0 \[m\]: equal for stone, much longer along one axis for wood. Those
    /// of a table are the robot's, from the table's centre.
    pub grain: Vector3<f64>,
    /// Greatest change of brightness, as a share: 0 is none, 1 is from black to twice as bright.
    pub contrast: f64,
    /// Number of the pattern.
    pub seed: u64,
}

impl Texture {
    /// What the color is multiplied by at a point of the body frame, seen from near by: `1 ± contrast`.
    pub fn factor(&self, point: &Point3<f64>) -> f64 {
        let place = point.coords.component_div(&self.grain);
        1.0 + self.contrast * Noise::new(self.seed).at(&place, 0.0)
    }
}

/// A texture as a camera has it before it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TextureInView {
    texture: Texture,
    /// From the camera frame to the body's, in units of the grain.
    turn: Matrix3<f64>,
    shift: Vector3<f64>,
    focal: f64,
}

impl TextureInView {
    /// The texture of a body for a camera with this focal length.
    pub(crate) fn new(texture: Texture, camera_from_body: &Isometry3<f64>, focal: f64) -> Self {
        let body_from_camera = camera_from_body.inverse();
        let per_grain = Matrix3::from_diagonal(&texture.grain.map(|grain| 1.0 / grain));
        let turn = per_grain * body_from_camera.rotation.to_rotation_matrix().matrix();
        let shift = per_grain * body_from_camera.translation.vector;
        Self { texture, turn, shift, focal }
    }

    /// Starts to look at it.
    pub(crate) fn weave(&self) -> Weave<'_> {
        Weave { view: self, noise: Noise::new(self.texture.seed) }
    }
}

/// A look at a texture. Neighboring places are fast.
pub(crate) struct Weave<'a> {
    view: &'a TextureInView,
    noise: Noise,
}

impl Weave<'_> {
    /// A color as the texture has it where a ray meets the surface at 1/z = `nearness`. The normal may have any length.
    pub(crate) fn dye(
        &mut self,
        color: Color,
        ray: &Vector3<f64>,
        nearness: f64,
        normal: &Vector3<f64>,
    ) -> Color {
        let TextureInView { texture, turn, shift, focal } = self.view;
        let depth = 1.0 / nearness;
        let point = turn * ray * depth;
        // How far the surface goes on from pixel to pixel along u and v, in units of the grain. 1/z on the tangential plane
        // is the product of `plane` with a ray.
        let plane = normal * (nearness / normal.dot(ray));
        let step = |axis: usize| (turn.column(axis) - point * plane[axis]) * (depth / focal);
        let squares = step(0).map(|s| s * s) + step(1).map(|s| s * s);
        let pixel = squares.x.max(squares.y).max(squares.z).sqrt();
        let factor = 1.0 + texture.contrast * self.noise.at(&(point + shift), pixel);
        color.map(|c| (c * factor).clamp(0.0, 1.0))
    }
}

/// The pattern, of grain 1.
struct Noise {
    octaves: [Octave; OCTAVES],
}

impl Noise {
    fn new(seed: u64) -> Self {
        Self { octaves: std::array::from_fn(|i| Octave::new(hash(hash(seed).wrapping_add(i as u64)))) }
    }

    /// Its value, in `[-1, 1]`, as pixels of a size show it. If the size is not a number, which is so where a surface is
    /// seen edge-on, they show none.
    fn at(&mut self, place: &Vector3<f64>, pixel: f64) -> f64 {
        let (mut sum, mut scale) = (0.0, 1.0);
        for octave in &mut self.octaves {
            let share = ((FADE[1] - scale * pixel) / (FADE[1] - FADE[0])).clamp(0.0, 1.0);
            if share > 0.0 {
                sum += share / scale * octave.at(&(place * scale));
            }
            scale *= 2.0;
        }
        // Smoothly to the bounds.
        let bounded = (GAIN * sum).clamp(-1.0, 1.0);
        bounded * (1.5 - 0.5 * bounded * bounded)
    }
}

/// Gradient noise on the lattice of the whole numbers.
struct Octave {
    seed: u64,
    /// Places of the lattice, for the noise is 0 there and no place shall be special.
    offset: Vector3<f64>,
    /// The cell of the lattice that was looked at last, by its number in the bits of [`BIAS`]` + number`.
    cell: Vector3<u64>,
    /// Its corners' linear functions of the place in the cell: gradient and value at 0.
    corners: [Vector4<f64>; 8],
}

impl Octave {
    fn new(seed: u64) -> Self {
        let offset = signed(seed).into();
        let mut octave = Self { seed, offset, cell: Vector3::zeros(), corners: [Vector4::zeros(); 8] };
        octave.enter(Vector3::zeros());
        octave
    }

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
        // The sum has no digits behind the point: it is rounded down, or up where `place` is whole, which is as good.
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

/// Three numbers in `[-1, 1)` from random bits.
fn signed(bits: u64) -> [f64; 3] {
    [0, 21, 42].map(|shift| (bits >> shift & 0x1f_ffff) as f64 / f64::from(1 << 20) - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stone(seed: u64) -> Texture {
        Texture { grain: Vector3::repeat(0.01), contrast: 1.0, seed }
    }

    /// Places without order, some tens of grains apart.
    fn places() -> impl Iterator<Item = Point3<f64>> {
        (0..20_000).map(|i| Point3::from(signed(hash(i)).map(|c| 0.3 * c)))
    }

    /// Mean and standard deviation.
    fn moments(values: impl Iterator<Item = f64>) -> (f64, f64) {
        let values: Vec<f64> = values.collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64;
        (mean, variance.sqrt())
    }

    #[test]
    fn brighter_and_darker_are_in_balance_and_make_use_of_the_contrast() {
        for seed in [0, 1, 1 << 40] {
            let (mean, deviation) = moments(places().map(|p| stone(seed).factor(&p)));
            assert!((mean - 1.0).abs() < 0.02, "{mean}");
            assert!((0.35..0.65).contains(&deviation), "{deviation}");
            let faint = Texture { contrast: 0.1, ..stone(seed) };
            assert!(places().all(|p| (0.9..=1.1).contains(&faint.factor(&p))));
        }
    }

    #[test]
    fn the_pattern_has_no_steps() {
        // Of the finest octave, cells are a quarter of the grain; the line passes through hundreds of them, steeply and flatly.
        let along = |i: u32| Point3::new(1e-6, 0.31e-6, -0.07e-6) * f64::from(i);
        let texture = stone(3);
        let steepest = (0..1_000_000_u32)
            .map(|i| (texture.factor(&along(i + 1)) - texture.factor(&along(i))).abs())
            .fold(0.0, f64::max);
        // A step of 1e-4 grains changes no more than some multiple of it.
        assert!(steepest < 3e-3, "{steepest}");
    }

    #[test]
    fn every_seed_is_another_pattern() {
        let product = |a: u64, b: u64| {
            moments(places().map(|p| (stone(a).factor(&p) - 1.0) * (stone(b).factor(&p) - 1.0))).0
        };
        assert!(product(1, 1) > 0.1);
        for (a, b) in [(1, 2), (0, u64::MAX), (7, 7 << 32)] {
            assert!(product(a, b).abs() < 0.01, "{a} and {b}");
        }
    }

    #[test]
    fn grain_is_the_size_along_each_axis() {
        let wood = Texture { grain: Vector3::new(0.05, 0.002, 0.01), ..stone(5) };
        for p in places() {
            let stretched = p.coords.component_mul(&Vector3::new(5.0, 0.2, 1.0)).into();
            assert!((wood.factor(&stretched) - stone(5).factor(&p)).abs() < 1e-9);
        }
    }

    #[test]
    fn pixels_as_coarse_as_the_grain_show_the_mean() {
        let at = |pixel| Noise::new(4).at(&Vector3::new(0.3, 12.6, -3.1), pixel);
        let differ = |a: f64, b: f64| (at(a) - at(b)).abs() > 1e-9;
        assert!(!differ(0.0, 0.01) && differ(0.0, 0.2) && differ(0.0, FADE[1]));
        assert!([FADE[1], f64::INFINITY, f64::NAN].into_iter().all(|pixel| at(pixel).abs() < 1e-12));
    }
}
