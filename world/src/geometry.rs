//! Overlap and distance of bodies. No other file uses parry or glam.

use crate::scene::{Body, Shape};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use parry3d_f64::math::{Pose, Vector};
use parry3d_f64::query;
use parry3d_f64::shape::{Ball, Cuboid, Cylinder, Shape as ParryShape};

/// Returns whether two bodies touch or intersect.
pub fn overlap(a: &Body, b: &Body) -> bool {
    let (a_shape, b_shape) = (parry_shape(&a.shape), parry_shape(&b.shape));
    // The only error is "unsupported pair of shapes", and parry supports all pairs of these. If it did not, a contact would be
    // the safe answer.
    query::intersection_test(&parry_pose(a), &*a_shape, &parry_pose(b), &*b_shape)
        .map_or(true, |found| found.intersecting)
}

/// Returns the shortest distance between two bodies \[m\], 0 if they overlap. It is exact except at the rims of cylinders, where
/// it is up to 0.02 mm too large.
pub fn distance(a: &Body, b: &Body) -> f64 {
    let (a_shape, b_shape) = (parry_shape(&a.shape), parry_shape(&b.shape));
    query::distance(&parry_pose(a), &*a_shape, &parry_pose(b), &*b_shape).map_or(0.0, |found| found.distance)
}

/// Returns whether a shape contains a point in the body frame.
pub fn contains(shape: &Shape, point: &Point3<f64>) -> bool {
    let in_parry = parry_turn(shape).inverse_transform_point(point);
    parry_shape(shape).contains_local_point(Vector::new(in_parry.x, in_parry.y, in_parry.z))
}

fn parry_shape(shape: &Shape) -> Box<dyn ParryShape> {
    match *shape {
        Shape::Cuboid { half_extents: h } => Box::new(Cuboid::new(Vector::new(h.x, h.y, h.z))),
        Shape::Cylinder { radius, half_height } => Box::new(Cylinder::new(half_height, radius)),
        Shape::Sphere { radius } => Box::new(Ball::new(radius)),
    }
}

/// Turns the cylinder axis of parry, y, to ours, z.
fn parry_turn(shape: &Shape) -> UnitQuaternion<f64> {
    match shape {
        Shape::Cylinder { .. } => {
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2)
        }
        Shape::Cuboid { .. } | Shape::Sphere { .. } => UnitQuaternion::identity(),
    }
}

fn parry_pose(body: &Body) -> Pose {
    let Isometry3 { translation, rotation } = body.robot_from_body * parry_turn(&body.shape);
    Pose::from_parts(translation.into(), rotation.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{block, body, cuboid};
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn shapes() -> impl Strategy<Value = Shape> {
        prop_oneof![
            prop::array::uniform3(0.02..0.16f64).prop_map(cuboid),
            (0.01..0.05f64, 0.01..0.08f64)
                .prop_map(|(radius, half_height)| Shape::Cylinder { radius, half_height }),
            (0.01..0.05f64).prop_map(|radius| Shape::Sphere { radius }),
        ]
    }

    fn bodies() -> impl Strategy<Value = Body> {
        let ranges = (prop::array::uniform3(-0.15..0.15f64), prop::array::uniform3(-1.5..1.5f64));
        (shapes(), ranges).prop_map(|(shape, (position, turn))| body(shape, position, turn))
    }

    /// The point of a body nearest to a given point, in closed form.
    fn nearest(body: &Body, point: &Point3<f64>) -> Point3<f64> {
        let p = body.robot_from_body.inverse_transform_point(point);
        let within = match body.shape {
            Shape::Cuboid { half_extents: h } => {
                Point3::new(p.x.clamp(-h.x, h.x), p.y.clamp(-h.y, h.y), p.z.clamp(-h.z, h.z))
            }
            Shape::Cylinder { radius, half_height } => {
                let scale = (radius / p.x.hypot(p.y)).min(1.0);
                Point3::new(p.x * scale, p.y * scale, p.z.clamp(-half_height, half_height))
            }
            Shape::Sphere { radius } => p * (radius / p.coords.norm()).min(1.0),
        };
        body.robot_from_body * within
    }

    /// Computes the distance of two convex bodies by alternating projections, which converge to their nearest points.
    fn distance_by_projections(a: &Body, b: &Body) -> f64 {
        let mut on_a = Point3::from(a.robot_from_body.translation.vector);
        let mut length = f64::INFINITY;
        for _ in 0..200_000 {
            let on_b = nearest(b, &on_a);
            on_a = nearest(a, &on_b);
            let shorter = (on_a - on_b).norm();
            if length - shorter < 1e-15 {
                break;
            }
            length = shorter;
        }
        length
    }

    proptest! {
        #[test]
        fn distance_is_the_limit_of_alternating_projections(a in bodies(), b in bodies()) {
            let expected = distance_by_projections(&a, &b);
            let cylinder = [&a, &b].iter().any(|body| matches!(body.shape, Shape::Cylinder { .. }));
            let tolerance = if cylinder { 5e-5 } else { 1e-9 };
            let found = distance(&a, &b);
            prop_assert!((found - expected).abs() < tolerance, "{found} for {expected}");
            if expected > 1e-5 {
                prop_assert!(!overlap(&a, &b));
            }
        }

        #[test]
        fn a_contained_point_is_its_own_nearest_point(shape in shapes(), p in prop::array::uniform3(-0.1..0.1f64)) {
            let point = Point3::from(p);
            let at_origin = body(shape, [0.0; 3], [0.0; 3]);
            let apart = (nearest(&at_origin, &point) - point).norm();
            prop_assert_eq!(contains(&shape, &point), apart < 1e-12);
        }

        #[test]
        fn bodies_around_a_common_point_overlap(a in bodies(), mut b in bodies()) {
            b.robot_from_body.translation = a.robot_from_body.translation;
            prop_assert!(overlap(&a, &b));
            prop_assert!(distance(&a, &b) < 1e-9);
        }
    }

    #[test]
    fn an_upright_cylinder_is_as_high_as_its_height() {
        let post = body(Shape::Cylinder { radius: 0.01, half_height: 0.1 }, [0.0; 3], [0.0; 3]);
        let above = block([0.2; 3], [0.0, 0.0, 0.25]);
        let beside = block([0.2; 3], [0.25, 0.0, 0.0]);
        assert_relative_eq!(distance(&post, &above), 0.05, epsilon = 1e-9);
        assert_relative_eq!(distance(&post, &beside), 0.14, epsilon = 1e-9);
    }

    #[test]
    fn two_corners_that_face_each_other_are_a_diagonal_apart() {
        let a = block([0.2; 3], [0.0; 3]);
        let b = block([0.2; 3], [0.21, 0.22, 0.22]);
        assert_relative_eq!(distance(&a, &b), 0.03, epsilon = 1e-9);
        assert!(!overlap(&a, &b));
        assert!(overlap(&a, &block([0.2; 3], [0.19; 3])));
    }
}
