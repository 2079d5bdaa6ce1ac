//! The pinhole camera.
//!
//! Pixel coordinates have their origin at the top left corner of the image, u to the right and v down. The center of the first
//! pixel is (0.5, 0.5).

use crate::config::CameraConfig;
use crate::units::{deg, mm};
use nalgebra::{Isometry3, Point2, Point3, Rotation3, Translation3, Vector3};

/// Intrinsic parameters of the wrist camera, and its mount on the hand.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// Image width \[pixels\].
    pub width: u32,
    /// Image height \[pixels\].
    pub height: u32,
    /// Focal length, equal along both axes \[pixels\].
    pub focal: f64,
    /// Principal point \[pixels\].
    pub center: Point2<f64>,
    /// Pose of the camera in the hand frame.
    pub hand_from_camera: Isometry3<f64>,
}

impl Camera {
    /// Creates the camera that a configuration describes.
    pub fn new(config: &CameraConfig) -> Self {
        let half_width = f64::from(config.width) / 2.0;
        // Right in the image is y of the hand, down is -x.
        let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        Self {
            width: config.width,
            height: config.height,
            focal: half_width / libm::tan(deg(config.horizontal_fov_deg) / 2.0),
            center: Point2::new(half_width, f64::from(config.height) / 2.0),
            hand_from_camera: Isometry3::from_parts(
                Translation3::new(0.0, 0.0, -mm(config.behind_hand_mm)),
                rotation.into(),
            ),
        }
    }

    /// Projects a point in front of the camera \[pixels\], which may lie outside the image. Returns `None` for a point behind it.
    pub fn project(&self, point_in_camera: &Point3<f64>) -> Option<Point2<f64>> {
        let depth = point_in_camera.z;
        (depth > 1e-6).then(|| {
            Point2::new(
                self.center.x + self.focal * point_in_camera.x / depth,
                self.center.y + self.focal * point_in_camera.y / depth,
            )
        })
    }

    /// Returns the direction of the ray through an image point in the camera frame, with z = 1.
    pub fn ray(&self, pixel: &Point2<f64>) -> Vector3<f64> {
        Vector3::new((pixel.x - self.center.x) / self.focal, (pixel.y - self.center.y) / self.focal, 1.0)
    }

    /// Returns whether a point in the robot frame is within the image when the hand is at a pose.
    pub fn sees(&self, robot_from_hand: &Isometry3<f64>, point_in_robot: &Point3<f64>) -> bool {
        let robot_from_camera = robot_from_hand * self.hand_from_camera;
        let point_in_camera = robot_from_camera.inverse_transform_point(point_in_robot);
        self.project(&point_in_camera).is_some_and(|pixel| {
            (0.0..f64::from(self.width)).contains(&pixel.x)
                && (0.0..f64::from(self.height)).contains(&pixel.y)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn vga() -> Camera {
        Camera::new(&CameraConfig {
            width: 640,
            height: 480,
            horizontal_fov_deg: 60.0,
            behind_hand_mm: 100.0,
        })
    }

    #[test]
    fn sixty_degrees_over_640_pixels_is_a_focal_length_of_554_pixels() {
        assert_relative_eq!(vga().focal, 320.0 * 3f64.sqrt(), epsilon = 1e-9);
        let edge = vga().project(&Point3::new((std::f64::consts::FRAC_PI_6).tan(), 0.0, 1.0));
        assert_relative_eq!(edge.unwrap(), Point2::new(640.0, 240.0), epsilon = 1e-9);
    }

    #[test]
    fn a_ray_passes_through_the_point_that_projects_to_its_pixel() {
        let point = Point3::new(0.03, -0.02, 0.2);
        let pixel = vga().project(&point).unwrap();
        assert_relative_eq!(vga().ray(&pixel) * point.z, point.coords, epsilon = 1e-12);
        assert!(vga().project(&Point3::new(0.0, 0.0, -0.1)).is_none());
    }

    #[test]
    fn forward_of_the_robot_is_up_in_the_image() {
        let camera = vga();
        let hand = crate::pose::HandPose { position: Vector3::new(0.3, 0.1, 0.2), angles: Vector3::zeros() };
        let robot_from_camera = hand.robot_from_hand() * camera.hand_from_camera;
        let see = |x, y| {
            camera.project(&robot_from_camera.inverse_transform_point(&Point3::new(x, y, 0.0))).unwrap()
        };
        assert_relative_eq!(see(0.3, 0.1), camera.center, epsilon = 1e-9);
        assert!(see(0.35, 0.1).y < camera.center.y, "forward is up");
        assert!(see(0.3, 0.05).x > camera.center.x, "the robot's right is right");
        // The point is 0.3 m below the camera and 0.05 m to its side.
        assert_relative_eq!(see(0.3, 0.05).x - camera.center.x, camera.focal * 0.05 / 0.3, epsilon = 1e-9);
    }
}
