//! Ranges of hand poses (paper, Section 6.2).

use super::random::uniform;
use crate::config::RangeConfig;
use nalgebra::{Point3, Vector3};
use rand_chacha::ChaCha8Rng;
use world::pose::HandPose;
use world::units::{deg, mm};

/// A range of hand poses relative to a target.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseRange {
    /// Height of the reference point above the center of the target \[m\].
    pub reference: f64,
    /// Half-widths of the position along the axes of the robot frame \[m\].
    pub position: Vector3<f64>,
    /// Half-widths of `φ θ ψ` \[rad\].
    pub angles: Vector3<f64>,
}

impl PoseRange {
    /// Converts the configured range to SI units.
    pub fn new(config: &RangeConfig) -> Self {
        Self {
            reference: mm(config.reference_mm),
            position: Vector3::new(config.x_mm, config.y_mm, config.z_mm).map(mm),
            angles: Vector3::new(config.phi_deg, config.theta_deg, config.psi_deg).map(deg),
        }
    }

    /// Draws a pose uniformly; `ψ` is relative to `turn` \[rad\].
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
    use crate::scene::stream;
    use world::units::{to_deg, to_mm};

    /// Range 1 of the paper.
    fn range_1() -> PoseRange {
        let (reference_mm, x_mm, y_mm, z_mm) = (150.0, 100.0, 100.0, 100.0);
        let (phi_deg, theta_deg, psi_deg) = (5.0, 5.0, 30.0);
        PoseRange::new(&RangeConfig { reference_mm, x_mm, y_mm, z_mm, phi_deg, theta_deg, psi_deg })
    }

    #[test]
    fn draws_fill_the_range_uniformly() {
        let target = Point3::new(0.3, 0.2, -0.01);
        let mut rng = stream(7, 0);
        let draws: Vec<HandPose> = (0..20_000).map(|_| range_1().sample(&target, 0.0, &mut rng)).collect();
        // A uniform draw from [c - h, c + h] has mean c and variance h²/3.
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
}
