//! Measuring points: nearly uniform directions around the hand (paper, Sections 4.2 and 6.3).
//!
//! The paper uses the GSS Generator (`takatoh/gss_generator`): the generalized spiral of Rakhmanov, Saff and Zhou (1994) in the
//! form given by Saff and Kuijlaars (1997).

use nalgebra::{Unit, UnitVector3, Vector3};

/// Directions `g_n`, from the south pole of the unit sphere to its north pole. They originate at the position of the hand; their
/// axes are parallel to those of the robot frame.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuringPoints {
    directions: Vec<UnitVector3<f64>>,
}

impl MeasuringPoints {
    /// Distributes `count` points on a spiral.
    ///
    /// # Panics
    /// If `count` is less than two: a spiral has two ends.
    pub fn spiral(count: usize) -> Self {
        assert!(count >= 2, "a spiral of {count} points");
        let last = (count - 1) as f64;
        let mut longitude = 0.0;
        let directions = (0..count).map(|k| {
            let height = -1.0 + 2.0 * k as f64 / last;
            let ring = (1.0 - height * height).max(0.0).sqrt();
            longitude = if k == 0 || k == count - 1 {
                0.0
            } else {
                (longitude + 3.6 / ((count as f64).sqrt() * ring)) % std::f64::consts::TAU
            };
            let (sin, cos) = libm::sincos(longitude);
            Unit::new_normalize(Vector3::new(ring * cos, ring * sin, height))
        });
        Self { directions: directions.collect() }
    }

    /// Returns the directions `g_1 … g_N`.
    pub fn directions(&self) -> &[UnitVector3<f64>] {
        &self.directions
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn the_180_points_are_where_the_formula_puts_them() {
        let points = MeasuringPoints::spiral(180);
        let expected = [
            (0, [0.0, 0.0, -1.0]),
            (1, [-0.033_873, 0.145_169, -0.988_827]),
            (2, [-0.209_776, 0.013_689, -0.977_654]),
            (89, [-0.855_959, -0.517_013, -0.005_587]),
            (179, [0.0, 0.0, 1.0]),
        ];
        assert_eq!(points.directions().len(), 180);
        for (index, point) in expected {
            assert_relative_eq!(
                points.directions()[index].into_inner(),
                Vector3::from(point),
                epsilon = 1e-6
            );
        }
        assert_eq!(points.directions().iter().filter(|g| g.z <= 0.0).count(), 90);
    }

    #[test]
    fn neighbors_are_about_15_degrees_apart() {
        let points = MeasuringPoints::spiral(180);
        let directions = points.directions();
        let nearest: Vec<f64> = directions
            .iter()
            .map(|g| directions.iter().filter(|h| h != &g).map(|h| g.angle(h)).fold(f64::INFINITY, f64::min))
            .map(f64::to_degrees)
            .collect();
        let extreme = |pick: fn(f64, f64) -> f64, start| nearest.iter().copied().fold(start, pick);
        assert_relative_eq!(extreme(f64::min, f64::INFINITY), 8.573, epsilon = 1e-3);
        assert_relative_eq!(extreme(f64::max, 0.0), 15.529, epsilon = 1e-3);
        assert_relative_eq!(nearest.iter().sum::<f64>() / 180.0, 14.909, epsilon = 1e-3);
    }
}
