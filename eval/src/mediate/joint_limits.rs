//! Joint limits as bounds on the joint displacement of one step (paper, Section 5.2).

use super::row::Row;
use nalgebra::RowVector6;
use world::arm::{JointLimits, JointVector};

/// Distance of the bounds from the limits, so that rounding in `joints + displacement` cannot exceed a limit \[rad\].
const ROUNDING: f64 = 1e-9;

/// Range of each joint's displacement in one step \[rad\]. `lower <= upper` always holds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DisplacementBounds {
    /// Smallest displacement.
    pub lower: JointVector,
    /// Largest displacement.
    pub upper: JointVector,
}

impl DisplacementBounds {
    /// Computes the bounds that position and velocity limits set for a step of `period` seconds from `joints`.
    ///
    /// The paper prints the limits themselves, although the unknown is a displacement. The bounds here are
    /// `limit - current`. A joint outside its limits has to return as fast as its velocity limit allows, so that the problem
    /// stays feasible.
    pub fn new(limits: &JointLimits, joints: &JointVector, period: f64) -> Self {
        let fastest = limits.max_velocity * period;
        let within_reach =
            |room: JointVector| room.zip_map(&fastest, |room, fastest| room.clamp(-fastest, fastest));
        Self {
            lower: within_reach((limits.lower - joints).add_scalar(ROUNDING)),
            upper: within_reach((limits.upper - joints).add_scalar(-ROUNDING)),
        }
    }

    /// Eq. (7): `A = (I; -I)`, `b = (upper; -lower)`.
    pub(crate) fn rows(&self) -> impl Iterator<Item = Row> {
        let unit = |joint: usize, sign: f64| {
            let mut a = RowVector6::zeros();
            a[joint] = sign;
            a
        };
        let (lower, upper) = (self.lower, self.upper);
        (0..6).flat_map(move |joint| {
            [Row::hard(unit(joint, 1.0), upper[joint]), Row::hard(unit(joint, -1.0), -lower[joint])]
        })
    }

    /// Returns the nearest displacement within the bounds. This removes violations within the solver's tolerance.
    pub fn clamp(&self, displacement: &JointVector) -> JointVector {
        displacement.zip_zip_map(&self.lower, &self.upper, f64::clamp)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn limits() -> JointLimits {
        JointLimits {
            lower: JointVector::repeat(-1.0),
            upper: JointVector::repeat(2.0),
            max_velocity: JointVector::repeat(3.0),
        }
    }

    #[test]
    fn far_from_its_limits_a_joint_is_bounded_by_its_velocity() {
        let bounds = DisplacementBounds::new(&limits(), &JointVector::zeros(), 0.1);
        assert_relative_eq!(bounds.lower, JointVector::repeat(-0.3), epsilon = 1e-12);
        assert_relative_eq!(bounds.upper, JointVector::repeat(0.3), epsilon = 1e-12);
    }

    #[test]
    fn near_a_limit_a_joint_is_bounded_by_its_distance_from_it() {
        let bounds = DisplacementBounds::new(&limits(), &JointVector::repeat(1.9), 0.1);
        assert_relative_eq!(bounds.upper, JointVector::repeat(0.1), epsilon = 1e-8);
        assert!((JointVector::repeat(1.9) + bounds.upper).iter().all(|&joint| joint <= 2.0));
    }

    #[test]
    fn a_joint_outside_returns_at_once_or_as_fast_as_it_can() {
        let near = DisplacementBounds::new(&limits(), &JointVector::repeat(2.05), 0.1);
        assert_relative_eq!(near.upper, JointVector::repeat(-0.05), epsilon = 1e-8);
        let far = DisplacementBounds::new(&limits(), &JointVector::repeat(-2.0), 0.1);
        assert_relative_eq!(far.lower, JointVector::repeat(0.3), epsilon = 1e-12);
        assert_relative_eq!(far.upper, far.lower, epsilon = 1e-12);
    }

    #[test]
    fn rows_admit_what_lies_within_the_bounds_and_nothing_else() {
        let bounds = DisplacementBounds::new(&limits(), &JointVector::repeat(1.9), 0.1);
        let admits = |displacement: &JointVector| bounds.rows().all(|row| row.excess(displacement) <= 1e-12);
        assert!(admits(&bounds.lower) && admits(&bounds.upper) && admits(&JointVector::zeros()));
        for joint in 0..6 {
            let mut beyond = JointVector::zeros();
            beyond[joint] = bounds.upper[joint] + 1e-6;
            assert!(!admits(&beyond), "joint {joint}");
            beyond[joint] = bounds.lower[joint] - 1e-6;
            assert!(!admits(&beyond), "joint {joint}");
            assert_relative_eq!(bounds.clamp(&beyond)[joint], bounds.lower[joint]);
        }
    }
}
