//! Even draws, and the ranges of hand poses from Section 6.2 of the paper.

use crate::config::RangeConfig;
use nalgebra::{Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use world::pose::HandPose;
use world::units::{deg, mm};

/// The random stream of one example: a pure function of its dataset's seed and its index.
pub fn stream(seed: u64, index: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index);
    rng
}

/// An even draw from `[from, to)`; `from` where both are equal.
pub(crate) fn uniform([from, to]: [f64; 2], rng: &mut ChaCha8Rng) -> f64 {
    from + (to - from) * rng.random::<f64>()
}

/// A range of hand poses relative to a target.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseRange {
    /// Height of the reference point above the target's centre \[m\].
    pub reference: f64,
    /// Half-widths of the position along the robot's axes \[m\].
    pub position: Vector3<f64>,
    /// Half-widths of `φ θ ψ` \[rad\].
    pub angles: Vector3<f64>,
}

impl PoseRange {
    /// From the configuration.
    pub fn new(config: &RangeConfig) -> Self {
        Self {
            reference: mm(config.reference_mm),
            position: Vector3::new(config.x_mm, config.y_mm, config.z_mm).map(mm),
            angles: Vector3::new(config.phi_deg, config.theta_deg, config.psi_deg).map(deg),
        }
    }

    /// Draws a pose evenly; `ψ` counts from `turn` \[rad\].
    pub fn sample(&self, target_center: &Point3<f64>, turn: f64, rng: &mut ChaCha8Rng) -> HandPose {
        let mut around_zero = |half: f64| uniform([-half, half], rng);
        let offset = self.position.map(&mut around_zero);
        let angles = self.angles.map(&mut around_zero) + Vector3::z() * turn;
        HandPose { position: target_center.coords + Vector3::z() * self.reference + offset, angles }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use world::units::{to_deg, to_mm};

    /// Range 1 of the paper.
    fn range_1() -> PoseRange {
        let (reference_mm, x_mm, y_mm, z_mm) = (150.0, 100.0, 100.0, 100.0);
        let (phi_deg, theta_deg, psi_deg) = (5.0, 5.0, 30.0);
        PoseRange::new(&RangeConfig { reference_mm, x_mm, y_mm, z_mm, phi_deg, theta_deg, psi_deg })
    }

    #[test]
    fn draws_fill_the_range_evenly() {
        let target = Point3::new(0.3, 0.2, -0.01);
        let mut rng = stream(7, 0);
        let draws: Vec<HandPose> = (0..20_000).map(|_| range_1().sample(&target, 0.0, &mut rng)).collect();
        // An even draw on [c - h, c + h] has mean c and variance h²/3.
        let check = |center: f64, half: f64, value: &dyn Fn(&HandPose) -> f64| {
            let offsets: Vec<f64> = draws.iter().map(|draw| (value(draw) - center) / half).collect();
            assert!(offsets.iter().all(|offset| offset.abs() <= 1.0));
            let mean = offsets.iter().sum::<f64>() / 20_000.0;
            let variance = offsets.iter().map(|offset| offset * offset).sum::<f64>() / 20_000.0;
            assert!(mean.abs() < 0.02 && (variance - 1.0 / 3.0).abs() < 0.01, "{mean} {variance}");
        };
        check(300.0, 100.0, &|draw| to_mm(draw.position.x));
        check(200.0, 100.0, &|draw| to_mm(draw.position.y));
        check(140.0, 100.0, &|draw| to_mm(draw.position.z));
        check(0.0, 5.0, &|draw| to_deg(draw.angles.x));
        check(0.0, 5.0, &|draw| to_deg(draw.angles.y));
        check(0.0, 30.0, &|draw| to_deg(draw.angles.z));
    }

    #[test]
    fn streams_of_different_seeds_and_indices_differ() {
        let first = |seed, index| stream(seed, index).random::<u64>();
        assert_eq!(first(1, 2), first(1, 2));
        assert_ne!(first(1, 2), first(1, 3));
        assert_ne!(first(1, 2), first(2, 2));
    }
}
