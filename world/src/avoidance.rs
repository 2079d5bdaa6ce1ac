//! The avoidance map: which ways lead towards an obstacle (paper, Section 4.2). Ground truth of `CNN_avoid`.
//!
//! Every obstacle is replaced by small cubes, the obstacle elements (Section 6.3: 10 mm). As printed, Eq. (1) knows
//! directions but no distances: a far obstacle counts as much as a near one.

use crate::geometry::contains;
use crate::measuring_points::MeasuringPoints;
use crate::scene::Scene;
use nalgebra::{Point3, UnitVector3};
use serde::{Deserialize, Serialize};

/// Avoidance values `G_n`, one for each measuring point, in `[0, 1]`: 0 is free, 1 is straight at an obstacle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AvoidanceMap {
    /// `G_1 … G_N`.
    pub values: Vec<f64>,
}

impl AvoidanceMap {
    /// Eq. (1) for the vectors from every origin (the hand's position and the reference points on its edges) to every
    /// obstacle element; all points in the robot frame.
    pub fn new(points: &MeasuringPoints, origins: &[Point3<f64>], elements: &ObstacleElements) -> Self {
        let obstacles = origins.iter().flat_map(|origin| elements.directions_from(origin));
        Self { values: avoidance_values(points.directions(), obstacles) }
    }
}

/// Eq. (1): `G_n = max { g_n · v_o1/‖v_o1‖, …, g_n · v_om/‖v_om‖, 0 }` for all n side by side, which a
/// compiler turns into vector instructions: three million cosines a millisecond.
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
    // A cosine of 1 may come out a rounding error above it.
    values.into_iter().map(|value: f64| value.min(1.0)).collect()
}

/// The cubes that approximate the obstacles of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct ObstacleElements {
    centers: Vec<Point3<f64>>,
}

impl ObstacleElements {
    /// Cubes of the given side \[m\] with the body's axes, in a grid that is symmetric about the body's centre: as many
    /// as fit each side best, without those whose centres lie outside the shape.
    pub fn of(scene: &Scene, side: f64) -> Self {
        let mut centers = Vec::new();
        for obstacle in &scene.obstacles {
            let half = obstacle.shape.half_extents();
            for x in grid(half.x, side) {
                for y in grid(half.y, side) {
                    let column = grid(half.z, side).map(|z| Point3::new(x, y, z));
                    let inside = column.filter(|center| contains(&obstacle.shape, center));
                    centers.extend(inside.map(|center| obstacle.robot_from_body * center));
                }
            }
        }
        Self { centers }
    }

    /// Centres of the cubes in the robot frame.
    pub fn centers(&self) -> &[Point3<f64>] {
        &self.centers
    }

    /// Directions from a point to the centres. A centre at the point itself has none and is left out.
    fn directions_from(&self, origin: &Point3<f64>) -> impl Iterator<Item = UnitVector3<f64>> {
        self.centers.iter().filter_map(move |center| UnitVector3::try_new(center - origin, 1e-9))
    }
}

/// Centres of the cells that best fill a side, symmetric about its middle; at least one.
fn grid(half_side: f64, cell: f64) -> impl Iterator<Item = f64> {
    let count = (2.0 * half_side / cell).round().max(1.0) as u32;
    (0..count).map(move |index| (f64::from(index) - f64::from(count - 1) / 2.0) * cell)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{LightConfig, TableConfig};
    use crate::scene::{Body, Light, Material, Table};
    use crate::shape::Shape;
    use approx::assert_relative_eq;
    use nalgebra::{Isometry3, Vector3};
    use proptest::prelude::*;

    fn body(shape: Shape, position: [f64; 3], turn: [f64; 3]) -> Body {
        let robot_from_body = Isometry3::new(position.into(), turn.into());
        Body { shape, robot_from_body, material: Material { color: [0.5; 3], cross: None, texture: None } }
    }

    fn cuboid(sides: [f64; 3]) -> Shape {
        Shape::Cuboid { half_extents: Vector3::from(sides) / 2.0 }
    }

    fn scene(obstacles: Vec<Body>) -> Scene {
        let table = TableConfig { center_mm: [400.0, 180.0, -20.0], size_mm: [1000.0; 2], color: [0.5; 3] };
        Scene {
            table: Table::new(&table),
            target: body(cuboid([0.05; 3]), [0.36, 0.18, 0.0], [0.0; 3]),
            obstacles,
            light: Light::new(&LightConfig { towards_light: [0.0, 0.0, 1.0], ambient: 0.5 }),
            background: [0.0; 3],
        }
    }

    fn elements(obstacles: Vec<Body>) -> ObstacleElements {
        ObstacleElements::of(&scene(obstacles), 0.01)
    }

    /// An obstacle of a single element.
    fn crumb(position: [f64; 3]) -> Body {
        body(cuboid([0.01; 3]), position, [0.0; 3])
    }

    fn map(origins: &[[f64; 3]], obstacles: Vec<Body>) -> Vec<f64> {
        let origins: Vec<_> = origins.iter().map(|&origin| Point3::from(origin)).collect();
        AvoidanceMap::new(&MeasuringPoints::spiral(180), &origins, &elements(obstacles)).values
    }

    /// `max(0, cosine)` of every measuring point with one direction.
    fn cosines(direction: [f64; 3]) -> Vec<f64> {
        let direction = Vector3::from(direction).normalize();
        MeasuringPoints::spiral(180).directions().iter().map(|g| g.dot(&direction).max(0.0)).collect()
    }

    #[test]
    fn without_obstacles_every_way_is_free() {
        assert_eq!(map(&[[0.3, 0.1, 0.2]], vec![]), vec![0.0; 180]);
    }

    #[test]
    fn one_element_straight_ahead_is_the_cosine_with_it() {
        let values = map(&[[0.3, 0.1, 0.2]], vec![crumb([0.3, 0.1, 0.1])]);
        assert_relative_eq!(values[0], 1.0, epsilon = 1e-12);
        assert_relative_eq!(values[..], cosines([0.0, 0.0, -1.0])[..], epsilon = 1e-12);
        // The way back is free.
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
        // The element is straight ahead of the fingertip along x, below and aside of the palm centre.
        let (palm, fingertip, element) = ([0.3, 0.1, 0.2], [0.3, 0.16, 0.13], [0.4, 0.16, 0.13]);
        let both = map(&[palm, fingertip], vec![crumb(element)]);
        let from_palm = cosines([0.1, 0.06, -0.07]);
        let from_fingertip = cosines([1.0, 0.0, 0.0]);
        let expected: Vec<f64> = from_palm.iter().zip(&from_fingertip).map(|(a, b)| a.max(*b)).collect();
        assert_relative_eq!(both[..], expected[..], epsilon = 1e-12);
        assert!((0..180).any(|n| both[n] > from_palm[n] + 0.2));
    }

    #[test]
    fn a_hand_at_an_element_is_no_nan() {
        assert_eq!(map(&[[0.3, 0.1, 0.0]], vec![crumb([0.3, 0.1, 0.0])]), vec![0.0; 180]);
    }

    #[test]
    fn elements_fill_the_shape_symmetrically() {
        let turned = body(cuboid([0.03, 0.045, 0.02]), [0.4, 0.1, 0.0], [0.2, 0.1, 0.7]);
        let filled = elements(vec![turned.clone()]);
        // 4.5 cells along y round to 5.
        assert_eq!(filled.centers().len(), 3 * 5 * 2);
        let middle = filled.centers().iter().map(|center| center.coords).sum::<Vector3<f64>>() / 30.0;
        assert_relative_eq!(middle, turned.robot_from_body.translation.vector, epsilon = 1e-12);
        let corner = turned.robot_from_body * Point3::new(0.01, 0.02, 0.005);
        assert!(filled.centers().iter().any(|center| (center - corner).norm() < 1e-12));

        // Two layers of the cells of a disc of radius 2.5 cells: 5 x 5 without the 4 corners.
        let disc = body(Shape::Cylinder { radius: 0.0251, half_height: 0.01 }, [0.0; 3], [0.0; 3]);
        assert_eq!(elements(vec![disc]).centers().len(), 2 * 21);
        // 81 points of the lattice of whole numbers are no farther than √6 from the origin, and none between √6 and √8.
        let ball = body(Shape::Sphere { radius: 0.0251 }, [0.0; 3], [0.0; 3]);
        assert_eq!(elements(vec![ball]).centers().len(), 81);
        // A thing smaller than an element is one element.
        let grain = body(Shape::Sphere { radius: 0.002 }, [0.1, 0.2, 0.3], [0.0; 3]);
        assert_eq!(elements(vec![grain]).centers(), [Point3::new(0.1, 0.2, 0.3)]);
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
            prop_assert!(all.iter().any(|&value| value > 0.9), "180 directions are nowhere 12 degrees apart");
        }
    }
}
