//! Obstacle elements: small cubes that fill the obstacles (paper, Section 6.3: 10 mm).

use crate::geometry::contains;
use crate::scene::Scene;
use nalgebra::{Point3, UnitVector3};

/// Cubes that approximate the obstacles of a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct ObstacleElements {
    centers: Vec<Point3<f64>>,
}

impl ObstacleElements {
    /// Fills the obstacles of a scene with cubes of the given side \[m\]. The cubes of a body are parallel to its axes and form a
    /// grid that is symmetric about its center. Along each axis, their number is the one that fits best. Cubes with their center
    /// outside the shape are left out.
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

    /// Returns the centers of the cubes in the robot frame.
    pub fn centers(&self) -> &[Point3<f64>] {
        &self.centers
    }

    /// Iterates over the directions from a point to the centers. A center at the point itself has no direction and is skipped.
    pub(super) fn directions_from(&self, origin: &Point3<f64>) -> impl Iterator<Item = UnitVector3<f64>> {
        self.centers.iter().filter_map(move |center| UnitVector3::try_new(center - origin, 1e-9))
    }
}

/// Iterates over the centers of the cells that best fill a side, symmetric about its middle. There is at least one.
fn grid(half_side: f64, cell: f64) -> impl Iterator<Item = f64> {
    let count = (2.0 * half_side / cell).round().max(1.0) as u32;
    (0..count).map(move |index| (f64::from(index) - f64::from(count - 1) / 2.0) * cell)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{body, cuboid, scene};
    use crate::scene::{Body, Shape};
    use approx::assert_relative_eq;
    use nalgebra::Vector3;

    fn elements(obstacles: Vec<Body>) -> ObstacleElements {
        ObstacleElements::of(&scene(obstacles), 0.01)
    }

    #[test]
    fn elements_fill_the_shape_symmetrically() {
        let turned = body(cuboid([0.03, 0.045, 0.02]), [0.4, 0.1, 0.0], [0.2, 0.1, 0.7]);
        let filled = elements(vec![turned.clone()]);
        // 4.5 cells along y are rounded to 5.
        assert_eq!(filled.centers().len(), 3 * 5 * 2);
        let middle = filled.centers().iter().map(|center| center.coords).sum::<Vector3<f64>>() / 30.0;
        assert_relative_eq!(middle, turned.robot_from_body.translation.vector, epsilon = 1e-12);
        let corner = turned.robot_from_body * Point3::new(0.01, 0.02, 0.005);
        assert!(filled.centers().iter().any(|center| (center - corner).norm() < 1e-12));

        // A disk with a radius of 2.5 cells has two layers of 5 x 5 cells without the 4 corners.
        let disk = body(Shape::Cylinder { radius: 0.0251, half_height: 0.01 }, [0.0; 3], [0.0; 3]);
        assert_eq!(elements(vec![disk]).centers().len(), 2 * 21);
        // 81 points of the integer lattice are within √6 of the origin, and none is between √6 and √8.
        let ball = body(Shape::Sphere { radius: 0.0251 }, [0.0; 3], [0.0; 3]);
        assert_eq!(elements(vec![ball]).centers().len(), 81);
        // A body smaller than an element is one element.
        let grain = body(Shape::Sphere { radius: 0.002 }, [0.1, 0.2, 0.3], [0.0; 3]);
        assert_eq!(elements(vec![grain]).centers(), [Point3::new(0.1, 0.2, 0.3)]);
    }
}
