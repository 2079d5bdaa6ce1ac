//! The avoidance map: how directly each direction of motion leads toward an obstacle (paper, Section 4.2).
//!
//! As printed, Eq. (1) depends on directions only, not on distances: a far obstacle counts as much as a near one.

use crate::avoidance::measuring_points::MeasuringPoints;
use crate::avoidance::obstacle_elements::ObstacleElements;
use nalgebra::{Point3, UnitVector3};
use serde::{Deserialize, Serialize};

/// Avoidance values `G_n` in `[0, 1]`, one per measuring point: 0 is free, 1 leads straight to an obstacle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AvoidanceMap {
    /// `G_1 … G_N`.
    pub values: Vec<f64>,
}

impl AvoidanceMap {
    /// Evaluates Eq. (1) for the vectors from every origin (the position of the hand and the reference points on its edges) to
    /// every obstacle element. All points are in the robot frame.
    pub fn new(points: &MeasuringPoints, origins: &[Point3<f64>], elements: &ObstacleElements) -> Self {
        let obstacles = origins.iter().flat_map(|origin| elements.directions_from(origin));
        Self { values: avoidance_values(points.directions(), obstacles) }
    }
}

/// Eq. (1): `G_n = max { g_n · v_o1/‖v_o1‖, …, g_n · v_om/‖v_om‖, 0 }`. The inner loop runs over n, so that the compiler
/// vectorizes it: three million cosines per millisecond.
fn avoidance_values(
    points: &[UnitVector3<f64>],
    obstacles: impl Iterator<Item = UnitVector3<f64>>,
) -> Vec<f64> {
    let [x, y, z] = [0, 1, 2].map(|axis| points.iter().map(|g| g[axis]).collect::<Vec<f64>>());
    let mut values = vec![0.0; points.len()];
    for v in obstacles {
        for (((value, x), y), z) in values.iter_mut().zip(&x).zip(&y).zip(&z) {
            let cosine = x * v.x + y * v.y + z * v.z;
            *value = if cosine > *value { cosine } else { *value };
        }
    }
    // Rounding may push a cosine above 1.
    values.into_iter().map(|value: f64| value.min(1.0)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{block, body, cuboid, scene};
    use crate::scene::Body;
    use approx::assert_relative_eq;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    /// An obstacle with a single element.
    fn crumb(position: [f64; 3]) -> Body {
        block([0.01; 3], position)
    }

    fn map(origins: &[[f64; 3]], obstacles: Vec<Body>) -> Vec<f64> {
        let origins: Vec<_> = origins.iter().map(|&origin| Point3::from(origin)).collect();
        let elements = ObstacleElements::of(&scene(obstacles), 0.01);
        AvoidanceMap::new(&MeasuringPoints::spiral(180), &origins, &elements).values
    }

    /// `max(0, cosine)` of the angle between each measuring point and a direction.
    fn cosines(direction: [f64; 3]) -> Vec<f64> {
        let direction = Vector3::from(direction).normalize();
        MeasuringPoints::spiral(180).directions().iter().map(|g| g.dot(&direction).max(0.0)).collect()
    }

    #[test]
    fn without_obstacles_every_direction_is_free() {
        assert_eq!(map(&[[0.3, 0.1, 0.2]], vec![]), vec![0.0; 180]);
    }

    #[test]
    fn one_element_straight_ahead_is_the_cosine_with_it() {
        let values = map(&[[0.3, 0.1, 0.2]], vec![crumb([0.3, 0.1, 0.1])]);
        assert_relative_eq!(values[0], 1.0, epsilon = 1e-12);
        assert_relative_eq!(values[..], cosines([0.0, 0.0, -1.0])[..], epsilon = 1e-12);
        // The opposite direction is free.
        assert!(values[90..].iter().all(|&value| value == 0.0));
    }

    #[test]
    fn distance_does_not_matter() {
        let hand = [0.3, 0.1, 0.2];
        let near = map(&[hand], vec![crumb([0.33, 0.08, 0.19])]);
        let far = map(&[hand], vec![crumb([0.6, -0.1, 0.1])]);
        assert_relative_eq!(near[..], far[..], epsilon = 1e-12);
    }

    #[test]
    fn a_reference_point_sees_what_the_center_does_not() {
        // The element is straight ahead of the fingertip along x, and below and to the side of the palm center.
        let (palm, fingertip, element) = ([0.3, 0.1, 0.2], [0.3, 0.16, 0.13], [0.4, 0.16, 0.13]);
        let both = map(&[palm, fingertip], vec![crumb(element)]);
        let from_palm = cosines([0.1, 0.06, -0.07]);
        let from_fingertip = cosines([1.0, 0.0, 0.0]);
        let expected: Vec<f64> = from_palm.iter().zip(&from_fingertip).map(|(a, b)| a.max(*b)).collect();
        assert_relative_eq!(both[..], expected[..], epsilon = 1e-12);
        assert!((0..180).any(|n| both[n] > from_palm[n] + 0.2));
    }

    #[test]
    fn a_hand_at_an_element_does_not_cause_nan() {
        assert_eq!(map(&[[0.3, 0.1, 0.0]], vec![crumb([0.3, 0.1, 0.0])]), vec![0.0; 180]);
    }

    fn obstacles() -> impl Strategy<Value = Vec<Body>> {
        let sides = prop::array::uniform3(0.005..0.06f64);
        let position = prop::array::uniform3(-0.2..0.2f64);
        let obstacle =
            (sides, position, -3.0..3.0f64).prop_map(|(s, p, yaw)| body(cuboid(s), p, [0.0, 0.0, yaw]));
        prop::collection::vec(obstacle, 1..4)
    }

    proptest! {
        #[test]
        fn one_more_obstacle_never_lowers_a_value(obstacles in obstacles()) {
            let origins = [[0.0, 0.0, 0.2], [0.05, 0.05, 0.15]];
            let all = map(&origins, obstacles.clone());
            let without_last = map(&origins, obstacles[..obstacles.len() - 1].to_vec());
            for (more, fewer) in all.iter().zip(&without_last) {
                prop_assert!(more >= fewer && (0.0..=1.0).contains(more));
            }
            prop_assert!(all.iter().any(|&value| value > 0.9), "no gap between the 180 directions is wider than 12 degrees");
        }
    }
}
