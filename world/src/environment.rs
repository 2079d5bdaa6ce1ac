//! The virtual environment as one value, for data generation and servoing.

use crate::arm::{Arm, Hand, hiro};
use crate::avoidance::{AvoidanceMap, MeasuringPoints, ObstacleElements};
use crate::camera::Camera;
use crate::color::Color;
use crate::config::WorldConfig;
use crate::error::Result;
use crate::render::Renderer;
use crate::scene::{Body, Cross, Light, Material, Scene, Shape, Table};
use crate::units::mm;
use image::RgbImage;
use nalgebra::{Isometry3, Point3};

/// Camera, renderer, arm, hand and measuring points of a configuration.
#[derive(Debug, Clone)]
pub struct Environment {
    /// Wrist camera.
    pub camera: Camera,
    /// Renderer for the wrist camera.
    pub renderer: Renderer,
    /// HIRO's left arm.
    pub arm: Arm,
    /// Hand at the end of the arm.
    pub hand: Hand,
    /// Directions of an avoidance map.
    pub measuring_points: MeasuringPoints,
    /// Configuration of this environment.
    pub config: WorldConfig,
}

impl Environment {
    /// Creates the environment that a configuration describes, after validating it.
    pub fn new(config: &WorldConfig) -> Result<Self> {
        config.validate()?;
        let camera = Camera::new(&config.camera);
        Ok(Self {
            renderer: Renderer::new(camera.clone()),
            camera,
            arm: hiro::left_arm(&config.arm),
            hand: Hand::new(&config.hand),
            measuring_points: MeasuringPoints::spiral(config.avoidance.measuring_points),
            config: config.clone(),
        })
    }

    /// Creates a scene on the configured table: a target with a cross, and obstacles. Poses are in the robot frame.
    pub fn scene(&self, target: (Shape, Isometry3<f64>), obstacles: Vec<(Shape, Isometry3<f64>)>) -> Scene {
        let colors = &self.config.colors;
        let body = |(shape, robot_from_body), color: Color, cross| Body {
            shape,
            robot_from_body,
            material: Material { color, cross, texture: None },
        };
        let sides = target.0.half_extents() * 2.0;
        let cross = Cross { color: colors.cross, width: colors.cross_width * sides.x.min(sides.y) };
        Scene {
            table: Table::new(&self.config.table),
            target: body(target, colors.target, Some(cross)),
            obstacles: obstacles.into_iter().map(|obstacle| body(obstacle, colors.obstacle, None)).collect(),
            light: Light::new(&self.config.light),
            background: colors.background,
        }
    }

    /// Renders the image of the wrist camera.
    pub fn wrist_image(&self, scene: &Scene, robot_from_hand: &Isometry3<f64>) -> RgbImage {
        self.renderer.color(scene, &(robot_from_hand * self.camera.hand_from_camera))
    }

    /// Computes the ground truth of `CNN_avoid`: Eq. (1) for the position of the hand and its reference points.
    pub fn avoidance_map(&self, scene: &Scene, robot_from_hand: &Isometry3<f64>) -> AvoidanceMap {
        let position = Point3::from(robot_from_hand.translation.vector);
        let edges = self.hand.reference_points().iter().map(|point| robot_from_hand * point);
        let origins: Vec<_> = std::iter::once(position).chain(edges).collect();
        let elements = ObstacleElements::of(scene, mm(self.config.avoidance.element_mm));
        AvoidanceMap::new(&self.measuring_points, &origins, &elements)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::cuboid;
    use crate::pose::HandPose;
    use approx::assert_relative_eq;
    use nalgebra::Vector3;

    /// The shipped configuration.
    fn config() -> WorldConfig {
        toml::from_str(include_str!("../../configs/world.toml")).unwrap()
    }

    /// A hand that looks straight down.
    fn hand_at(x: f64, y: f64, z: f64) -> Isometry3<f64> {
        HandPose { position: Vector3::new(x, y, z), angles: Vector3::zeros() }.robot_from_hand()
    }

    #[test]
    fn a_scene_has_the_configured_colors_and_a_cross_that_fits_the_target() {
        let world = Environment::new(&config()).unwrap();
        let on_table = |x, y| Isometry3::translation(x, y, 0.0);
        let obstacle = (Shape::Cylinder { radius: 0.02, half_height: 0.02 }, on_table(0.45, 0.2));
        let scene = world.scene((cuboid([0.12, 0.04, 0.03]), on_table(0.36, 0.18)), vec![obstacle]);
        let colors = config().colors;
        assert_eq!(
            scene.obstacles[0].material,
            Material { color: colors.obstacle, cross: None, texture: None }
        );
        assert_relative_eq!(scene.target.material.cross.unwrap().width, 0.25 * 0.04, epsilon = 1e-12);
        assert_relative_eq!(scene.table.height(), -0.02, epsilon = 1e-12);
    }

    #[test]
    fn the_configured_arm_looks_down_on_the_target_and_sees_it_in_the_middle() {
        let world = Environment::new(&config()).unwrap();
        let target = (cuboid([0.06, 0.04, 0.03]), Isometry3::translation(0.36, 0.18, -0.005));
        let scene = world.scene(target, vec![]);
        let above = hand_at(0.36, 0.18, 0.075);
        let joints = world.arm.joints_for(&above).unwrap();
        let robot_from_hand = world.arm.robot_from_hand(&joints);
        assert!(!world.hand.contacts(&robot_from_hand, &scene).any());
        let image = world.wrist_image(&scene, &robot_from_hand);
        let [red, green, _] = image.get_pixel(320, 240).0;
        assert!(red > 2 * green, "the red cross is in the middle");
        // The top is 165 mm below the camera. Its edges are 67 pixels to the side and 101 pixels ahead of the middle; the bars of
        // the cross extend 17 pixels to either side.
        let [red, green, _] = image.get_pixel(340, 175).0;
        assert!(red > 150 && green > 150, "the white target around it");
    }

    #[test]
    fn a_sphere_lies_on_the_table_with_a_cross_on_its_upper_side() {
        let world = Environment::new(&config()).unwrap();
        let ball = Shape::Sphere { radius: 0.025 };
        let scene = world.scene((ball, Isometry3::translation(0.36, 0.18, 0.005)), vec![]);
        assert_relative_eq!(scene.target.material.cross.unwrap().width, 0.25 * 0.05, epsilon = 1e-12);
        let hand = hand_at(0.36, 0.18, 0.085);
        assert!(!world.hand.contacts(&hand, &scene).any());
        assert_eq!(world.avoidance_map(&scene, &hand).values, vec![0.0; config().avoidance.measuring_points]);
        let image = world.wrist_image(&scene, &hand);
        let is_red = |x, y| image.get_pixel(x, y)[0] / 2 > image.get_pixel(x, y)[1];
        // The center is 180 mm below the camera, so the radius of the outline is 554 * 25 / √(180² - 25²) = 77.7 pixels. The bars
        // extend to it; half of their width is about 22 pixels.
        assert!(
            is_red(320, 240) && is_red(394, 240) && is_red(246, 240) && is_red(320, 166) && is_red(320, 314)
        );
        assert!(!is_red(360, 280) && !is_red(280, 200));
        assert_ne!(image.get_pixel(320 + 76, 240), image.get_pixel(320 + 80, 240));
    }

    #[test]
    fn an_avoidance_map_uses_axes_of_the_robot_and_the_edges_of_the_hand() {
        let world = Environment::new(&config()).unwrap();
        let post = (cuboid([0.01, 0.01, 0.01]), Isometry3::translation(0.36, 0.30, 0.1));
        let scene =
            world.scene((cuboid([0.06, 0.04, 0.03]), Isometry3::translation(0.36, 0.18, 0.0)), vec![post]);
        // The post is to the left of the palm, seen from the robot. Of the seven origins, the center of the palm and the corners
        // of its front face are at the height of the post.
        let hand = hand_at(0.36, 0.18, 0.1);
        let map = world.avoidance_map(&scene, &hand);
        let origins = [[0.0, 0.0, 0.0], [0.0, 0.062, 0.07], [0.0, -0.062, 0.07]];
        let corners = [[0.03, 0.062, 0.0], [0.03, -0.062, 0.0], [-0.03, 0.062, 0.0], [-0.03, -0.062, 0.0]];
        for (g, value) in world.measuring_points.directions().iter().zip(&map.values) {
            let cosine = |origin: &[f64; 3]| {
                let [x, y, z] = *origin;
                // Hand y is the robot's right, hand z down.
                let toward = Vector3::new(0.0, 0.12, 0.0) - Vector3::new(x, -y, -z);
                g.dot(&toward.normalize())
            };
            let expected = origins.iter().chain(&corners).map(cosine).fold(0.0, f64::max);
            assert_relative_eq!(*value, expected, epsilon = 1e-12);
        }
    }

    #[test]
    fn an_invalid_configuration_is_rejected() {
        let mut config = config();
        config.colors.cross_width = 1.5;
        let refused = Environment::new(&config).unwrap_err().to_string();
        assert!(refused.contains("colors.cross_width"), "{refused}");
    }
}
