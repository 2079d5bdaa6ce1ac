//! Field of view: rows that keep the image of one point of the target in view (paper, Section 5.2).
//!
//! The paper's example is a point straight below the hand at the goal. This presumes a known goal pose, with which there would
//! be no need to servo. Here the point is the target's center in the virtualized scene, which Section 3.1 reconstructs before
//! the servoing starts.

use super::row::Row;
use nalgebra::{Isometry3, Matrix2x6, Matrix6, Point2, Point3, Vector2};
use world::Camera;
use world::pose::adjoint;

/// Points closer to the camera than this move too fast in the image to be linearized \[m\].
const LEAST_DEPTH: f64 = 0.01;

/// The part of the image in which the point has to stay.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldOfView {
    hand_from_camera: Isometry3<f64>,
    /// Upper left corner in normalized image coordinates.
    lower: Vector2<f64>,
    /// Lower right corner in normalized image coordinates.
    upper: Vector2<f64>,
}

impl FieldOfView {
    /// Excludes a margin on each side of the image, given as a fraction of its width and height.
    pub fn new(camera: &Camera, margin: f64) -> Self {
        let size = Vector2::new(f64::from(camera.width), f64::from(camera.height));
        let corner = |share: f64| camera.ray(&Point2::from(size * share)).xy();
        Self { hand_from_camera: camera.hand_from_camera, lower: corner(margin), upper: corner(1.0 - margin) }
    }

    /// Eq. (8): `e_t + L Ad J q` stays within the rectangle, as rows on the joint displacement `q`.
    ///
    /// The paper prints `e + L J q`, without the change of frame from hand to camera between the hand's Jacobian `J` and the
    /// camera's interaction matrix `L`. It prints strict bounds. Here they are closed and soft, because a target that is
    /// already outside must not make the problem infeasible. A point behind the camera has no image and adds no rows.
    pub(crate) fn rows(
        &self,
        robot_from_hand: &Isometry3<f64>,
        jacobian: &Matrix6<f64>,
        target_in_robot: &Point3<f64>,
    ) -> Vec<Row> {
        let robot_from_camera = robot_from_hand * self.hand_from_camera;
        let target = robot_from_camera.inverse_transform_point(target_in_robot);
        if target.z < LEAST_DEPTH {
            return Vec::new();
        }
        let e = target.xy().coords / target.z;
        let camera_from_hand = adjoint(&self.hand_from_camera.inverse());
        let motion = interaction_matrix(&e, target.z) * camera_from_hand * jacobian;
        let axis = |i: usize| {
            let a = motion.row(i).into_owned();
            [Row::soft(a, self.upper[i] - e[i]), Row::soft(-a, e[i] - self.lower[i])]
        };
        [axis(0), axis(1)].concat()
    }
}

/// Returns the interaction matrix (image Jacobian) of a point: the derivative of its normalized image coordinates with respect
/// to the camera's twist in the camera frame, translation first. As in `vpFeaturePoint` of `ViSP`.
pub fn interaction_matrix(e: &Vector2<f64>, depth: f64) -> Matrix2x6<f64> {
    let (x, y) = (e.x, e.y);
    let near = 1.0 / depth;
    Matrix2x6::new(
        -near,
        0.0,
        x * near,
        x * y,
        -(1.0 + x * x),
        y, //
        0.0,
        -near,
        y * near,
        1.0 + y * y,
        -x * y,
        -x,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::Vector6;
    use proptest::prelude::*;
    use world::config::CameraConfig;
    use world::pose::{HandPose, PoseChange};

    fn vga() -> Camera {
        Camera::new(&CameraConfig {
            width: 640,
            height: 480,
            horizontal_fov_deg: 60.0,
            behind_hand_mm: 100.0,
        })
    }

    /// Normalized image coordinates of a point, from the pinhole model.
    fn seen(point_in_camera: &Point3<f64>) -> Vector2<f64> {
        point_in_camera.xy().coords / point_in_camera.z
    }

    proptest! {
        #[test]
        fn the_interaction_matrix_is_the_derivative_of_the_projection(
            x in -0.1..0.1f64, y in -0.1..0.1f64, z in 0.1..0.4f64, axis in 0..6usize,
        ) {
            let point = Point3::new(x, y, z);
            let moved = |step: f64| {
                let mut twist = Vector6::zeros();
                twist[axis] = step;
                seen(&PoseChange::from_array(twist.into()).exp().inverse_transform_point(&point))
            };
            let derivative = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            let column = interaction_matrix(&seen(&point), z).column(axis).into_owned();
            assert_relative_eq!(column, derivative, epsilon = 1e-6);
        }
    }

    fn looking_down() -> Isometry3<f64> {
        HandPose { position: [0.36, 0.18, 0.1].into(), angles: [0.05, -0.03, 0.4].into() }.robot_from_hand()
    }

    #[test]
    fn rows_bound_the_image_after_a_small_motion_of_the_hand() {
        let camera = vga();
        let field = FieldOfView::new(&camera, 0.0);
        let target = Point3::new(0.38, 0.15, 0.0);
        // With the identity as Jacobian, a joint displacement is a twist of the hand in the hand frame.
        let rows = field.rows(&looking_down(), &Matrix6::identity(), &target);
        let twist = Vector6::new(2.0, -1.0, 3.0, 1.0, -2.0, 3.0) * 1e-5;
        let hand = looking_down() * PoseChange::from_array(twist.into()).exp();
        let pixel =
            camera.project(&(hand * camera.hand_from_camera).inverse_transform_point(&target)).unwrap();
        let excess: Vec<f64> = rows.iter().map(|row| row.excess(&twist) * camera.focal).collect();
        let expected = [pixel.x - 640.0, -pixel.x, pixel.y - 480.0, -pixel.y];
        for (excess, expected) in excess.iter().zip(expected) {
            assert_relative_eq!(*excess, expected, epsilon = 1e-4);
        }
    }

    #[test]
    fn a_margin_is_taken_from_every_side() {
        let field = FieldOfView::new(&vga(), 0.1);
        assert_relative_eq!(field.upper * vga().focal, Vector2::new(256.0, 192.0), epsilon = 1e-9);
        assert_relative_eq!(field.lower, -field.upper, epsilon = 1e-12);
    }

    #[test]
    fn a_target_behind_the_camera_gives_no_rows() {
        let rows = FieldOfView::new(&vga(), 0.0).rows(
            &looking_down(),
            &Matrix6::identity(),
            &Point3::new(0.36, 0.18, 0.5),
        );
        assert!(rows.is_empty());
    }
}
