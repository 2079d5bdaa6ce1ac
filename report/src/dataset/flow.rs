//! Optical flow between two views: the position in the goal image of points in the current image.

use nalgebra::{Isometry3, Point2, Point3};
use world::{Camera, Renderer, Scene};

/// A surface point in two images \[pixels\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Flow {
    /// In the current image.
    pub(super) current: Point2<f64>,
    /// In the goal image.
    pub(super) goal: Point2<f64>,
}

/// Returns the flow at the centers of `columns` x `rows` equal parts of the current image. Pixels without a surface and points
/// outside the goal image are left out. Occlusion in the goal image is ignored.
pub(super) fn flow(
    camera: &Camera,
    scene: &Scene,
    [robot_from_current, robot_from_goal]: [&Isometry3<f64>; 2],
    [columns, rows]: [u32; 2],
) -> Vec<Flow> {
    let depth = Renderer::new(camera.clone()).frame(scene, robot_from_current).depth;
    let goal_from_current = robot_from_goal.inv_mul(robot_from_current);
    let middles = |count: u32, size: u32| (0..count).map(move |i| (2 * i + 1) * size / (2 * count));
    let pixels =
        middles(rows, camera.height).flat_map(|v| middles(columns, camera.width).map(move |u| (u, v)));
    let flow = |(u, v): (u32, u32)| {
        let z = f64::from(depth[(v * camera.width + u) as usize]);
        let current = Point2::new(f64::from(u) + 0.5, f64::from(v) + 0.5);
        let point_in_current = Point3::from(camera.ray(&current) * z);
        let goal = camera.project(&(goal_from_current * point_in_current)).filter(|_| z.is_finite())?;
        let is_inside = (0.0..f64::from(camera.width)).contains(&goal.x)
            && (0.0..f64::from(camera.height)).contains(&goal.y);
        is_inside.then_some(Flow { current, goal })
    };
    pixels.filter_map(flow).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::environment;
    use approx::assert_relative_eq;
    use nalgebra::Vector3;
    use world::Shape;
    use world::pose::HandPose;

    fn robot_from_camera(position: [f64; 3], angles: [f64; 3]) -> Isometry3<f64> {
        let hand = HandPose { position: position.into(), angles: angles.into() };
        hand.robot_from_hand() * environment().camera.hand_from_camera
    }

    fn scene() -> Scene {
        let target = Shape::Cuboid { half_extents: Vector3::new(0.03, 0.02, 0.02) };
        environment().scene((target, Isometry3::translation(0.36, 0.18, 0.0)), vec![])
    }

    #[test]
    fn an_arrow_leads_from_a_point_to_the_same_point() {
        let camera = environment().camera;
        // Straight above the target, so that the center of the image shows the center of its upper side.
        let current = robot_from_camera([0.36, 0.18, 0.12], [0.0; 3]);
        let goal = robot_from_camera([0.37, 0.16, 0.09], [0.05, -0.04, 0.3]);
        let flow = flow(&camera, &scene(), [&current, &goal], [5, 3]);
        let top = Point3::new(0.36, 0.18, 0.02);
        let expected = camera.project(&goal.inverse_transform_point(&top)).unwrap();
        let middle = flow.iter().min_by(|a, b| {
            let from_middle = |flow: &Flow| (flow.current - camera.center).norm();
            from_middle(a).total_cmp(&from_middle(b))
        });
        // The pixel's center is half a pixel off.
        let Flow { current, goal } = middle.unwrap();
        assert_relative_eq!(*current, camera.center, epsilon = 0.71);
        assert_relative_eq!(*goal, expected, epsilon = 1.5);
        assert!((goal - current).norm() > 20.0);
    }

    #[test]
    fn without_motion_points_stay_and_sideways_motion_moves_near_points_farther() {
        let camera = environment().camera;
        let current = robot_from_camera([0.36, 0.18, 0.12], [0.0; 3]);
        let still = flow(&camera, &scene(), [&current, &current], [8, 6]);
        assert_eq!(still.len(), 48);
        for Flow { current, goal } in still {
            assert_relative_eq!(current, goal, epsilon = 1e-9);
        }
        // 10 mm to the robot's left: everything moves right, the table 240 mm below the camera less than the target 200 mm below.
        let aside = robot_from_camera([0.36, 0.19, 0.12], [0.0; 3]);
        let moved = flow(&camera, &scene(), [&current, &aside], [8, 6]);
        let steps: Vec<f64> = moved.iter().map(|flow| (flow.goal - flow.current).x).collect();
        let extreme = |pick: fn(f64, f64) -> f64| steps.iter().copied().reduce(pick).unwrap();
        assert_relative_eq!(extreme(f64::min), camera.focal * 0.01 / 0.24, epsilon = 1e-3);
        assert_relative_eq!(extreme(f64::max), camera.focal * 0.01 / 0.20, epsilon = 1e-3);
    }

    #[test]
    fn points_that_leave_the_image_have_no_arrow() {
        let camera = environment().camera;
        let current = robot_from_camera([0.36, 0.18, 0.12], [0.0; 3]);
        // A quarter turn in place: an image wider than high loses its ends.
        let turned = robot_from_camera([0.36, 0.18, 0.12], [0.0, 0.0, std::f64::consts::FRAC_PI_2]);
        let flow = flow(&camera, &scene(), [&current, &turned], [16, 12]);
        assert_eq!(flow.len(), 12 * 12);
        let away = robot_from_camera([0.36, 0.18, 0.12], [std::f64::consts::PI, 0.0, 0.0]);
        assert_eq!(super::flow(&camera, &scene(), [&away, &current], [4, 3]), []);
    }
}
