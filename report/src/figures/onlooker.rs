//! An onlooker's view of the scene with arm and hand (Figures 7 and 9).

use image::RgbImage;
use nalgebra::{Isometry3, Matrix3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use world::arm::JointVector;
use world::{Camera, Environment, Renderer, Scene};

const ARM_COLOR: [f64; 3] = [0.86, 0.87, 0.89];
const HAND_COLOR: [f64; 3] = [0.20, 0.52, 0.82];

/// A camera beside the table, in front of the robot and to its right.
#[derive(Debug, Clone)]
pub(super) struct Onlooker {
    renderer: Renderer,
    robot_from_camera: Isometry3<f64>,
}

impl Onlooker {
    /// Points the camera at a target and the arm above it. Images are 4:3.
    pub(super) fn new(target: &Point3<f64>, width: u32) -> Self {
        let height = width * 3 / 4;
        let eye = target + Vector3::new(0.60, -0.50, 0.42);
        let forward = (target + Vector3::new(0.0, 0.0, 0.13) - eye).normalize();
        let right = forward.cross(&Vector3::z()).normalize();
        let axes = Matrix3::from_columns(&[right, forward.cross(&right), forward]);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let camera = Camera {
            width,
            height,
            focal: 1.25 * f64::from(width),
            center: Point2::new(f64::from(width) / 2.0, f64::from(height) / 2.0),
            hand_from_camera: Isometry3::identity(),
        };
        Self {
            renderer: Renderer::new(camera),
            robot_from_camera: Isometry3::from_parts(Translation3::from(eye), rotation),
        }
    }

    /// Renders the scene with the arm at these joint angles.
    pub(super) fn view(&self, environment: &Environment, scene: &Scene, joints: &JointVector) -> RgbImage {
        let Environment { arm, hand, .. } = environment;
        let mut scene = scene.clone();
        scene.obstacles.extend(arm.bodies(joints, ARM_COLOR));
        scene.obstacles.extend(hand.bodies(&arm.robot_from_hand(joints), HAND_COLOR));
        scene.background = [1.0, 1.0, 1.0];
        self.renderer.color(&scene, &self.robot_from_camera)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{environment, sessions};

    #[test]
    fn hand_and_target_are_visible() {
        let record = &sessions(1)[0];
        let onlooker = Onlooker::new(&record.scene.target_center(), 240);
        let view = onlooker.view(&environment(), &record.scene, &record.start_joints);
        assert_eq!((view.width(), view.height()), (240, 180));
        let share = |holds: &dyn Fn([i32; 3]) -> bool| {
            view.pixels().filter(|pixel| holds(pixel.0.map(i32::from))).count() as f64 / (240.0 * 180.0)
        };
        let (hand, cross) = (share(&|[r, _, b]| b > r + 30), share(&|[r, g, _]| r > g + 60));
        assert!(hand > 0.01 && hand < 0.3, "hand on {hand} of the image");
        assert!(cross > 0.0005, "cross on {cross} of the image");
    }
}
