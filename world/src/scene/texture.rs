//! Textures: patterns in the material of a body, as in wood or stone, that its surface cuts through. One pattern therefore suits
//! every shape, has no seams, and looks the same from all sides.

use crate::scene::gradient_noise::GradientNoise;
use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// A pattern that makes a color brighter and darker.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Texture {
    /// Size of the pattern along the axes of the body, above 0 \[m\]: equal along all axes for stone, much longer along one
    /// for wood. The axes of a table are the robot's, with their origin at the table's center.
    pub grain: Vector3<f64>,
    /// Maximum relative change of brightness: 0 means no texture, 1 ranges from black to twice the brightness.
    pub contrast: f64,
    /// Seed of the pattern.
    pub seed: u64,
}

impl Texture {
    /// Returns the factor, `1 ± contrast`, by which the texture multiplies the color at a point of the body frame, seen from
    /// close by.
    pub fn factor(&self, point: &Point3<f64>) -> f64 {
        let place = point.coords.component_div(&self.grain);
        1.0 + self.contrast * GradientNoise::new(self.seed).at(&place, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hash::{hash, signed};

    fn stone(seed: u64) -> Texture {
        Texture { grain: Vector3::repeat(0.01), contrast: 1.0, seed }
    }

    /// Random places, tens of grains apart.
    fn places() -> impl Iterator<Item = Point3<f64>> {
        (0..20_000).map(|i| Point3::from(signed(hash(i)).map(|c| 0.3 * c)))
    }

    /// Returns mean and standard deviation.
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
        // Cells of the finest octave are a quarter of the grain wide. The line crosses hundreds of them at various angles.
        let along = |i: u32| Point3::new(1e-6, 0.31e-6, -0.07e-6) * f64::from(i);
        let texture = stone(3);
        let steepest = (0..1_000_000_u32)
            .map(|i| (texture.factor(&along(i + 1)) - texture.factor(&along(i))).abs())
            .fold(0.0, f64::max);
        // A step of 1e-4 grains changes the value by a small multiple of 1e-4.
        assert!(steepest < 3e-3, "{steepest}");
    }

    #[test]
    fn each_seed_gives_a_different_pattern() {
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
}
