//! The virtual environment as one value: what a configuration builds, and what data generation and servoing ask of it.

use crate::arm::Arm;
use crate::avoidance::{AvoidanceMap, ObstacleElements};
use crate::camera::Camera;
use crate::config::WorldConfig;
use crate::error::Result;
use crate::hand::Hand;
use crate::hiro;
use crate::measuring_points::MeasuringPoints;
use crate::render::Renderer;
use crate::scene::{Body, Color, Cross, Light, Material, Scene, Table};
use crate::shape::Shape;
use crate::units::mm;
use image::RgbImage;
use nalgebra::{Isometry3, Point3};

/// Camera, renderer, arm, hand and measuring points of one configuration.
#[derive(Debug, Clone)]
pub struct Environment {
    /// The wrist camera.
    pub camera: Camera,
    /// Draws what the wrist camera sees.
    pub renderer: Renderer,
    /// HIRO's left arm.
    pub arm: Arm,
    /// The hand at its end.
    pub hand: Hand,
    /// Directions of an avoidance map.
    pub measuring_points: MeasuringPoints,
    /// What all of it was built from.
    pub config: WorldConfig,
}

impl Environment {
    /// From a configuration, which is validated first.
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

    /// A target with a cross on it and grey obstacles on the configuration's table, each with its pose in the robot frame.
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

    /// What the wrist camera sees.
    pub fn wrist_image(&self, scene: &Scene, robot_from_hand: &Isometry3<f64>) -> RgbImage {
        self.renderer.color(scene, &(robot_from_hand * self.camera.hand_from_camera))
    }

    /// Ground truth of `CNN_avoid`: Eq. (1) seen from the hand's position and from its reference points.
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
    use crate::pose::HandPose;
    use approx::assert_relative_eq;
    use nalgebra::Vector3;

    /// The configuration that ships.
    fn config() -> WorldConfig {
        toml::from_str(include_str!("../../configs/world.toml")).unwrap()
    }

    fn cuboid(sides: [f64; 3]) -> Shape {
        Shape::Cuboid { half_extents: Vector3::from(sides) / 2.0 }
    }

    /// Looking straight down.
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
        // The top is 165 mm below the camera: its edges are 67 pixels aside and 101 ahead of the middle, the cross's bars
        // reach 17 pixels to either side.
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
        // The centre is 180 mm below the camera, so that the outline's radius is 554 * 25 / √(180² - 25²) = 77.7 pixels, where
        // the bars end at 90° from the middle; half their width is about 22 pixels.
        assert!(
            is_red(320, 240) && is_red(394, 240) && is_red(246, 240) && is_red(320, 166) && is_red(320, 314)
        );
        assert!(!is_red(360, 280) && !is_red(280, 200));
        assert_ne!(image.get_pixel(320 + 76, 240), image.get_pixel(320 + 80, 240));
    }

    #[test]
    fn an_avoidance_map_speaks_in_axes_of_the_robot_and_knows_the_edges_of_the_hand() {
        let world = Environment::new(&config()).unwrap();
        let post = (cuboid([0.01, 0.01, 0.01]), Isometry3::translation(0.36, 0.30, 0.1));
        let scene =
            world.scene((cuboid([0.06, 0.04, 0.03]), Isometry3::translation(0.36, 0.18, 0.0)), vec![post]);
        // To the robot's left of the palm; of the seven origins, the palm's centre and its front face are at its height.
        let hand = hand_at(0.36, 0.18, 0.1);
        let map = world.avoidance_map(&scene, &hand);
        let origins = [[0.0, 0.0, 0.0], [0.0, 0.062, 0.07], [0.0, -0.062, 0.07]];
        let corners = [[0.03, 0.062, 0.0], [0.03, -0.062, 0.0], [-0.03, 0.062, 0.0], [-0.03, -0.062, 0.0]];
        for (g, value) in world.measuring_points.directions().iter().zip(&map.values) {
            let cosine = |origin: &[f64; 3]| {
                let [x, y, z] = *origin;
                // Hand y is the robot's right, hand z down.
                let towards = Vector3::new(0.0, 0.12, 0.0) - Vector3::new(x, -y, -z);
                g.dot(&towards.normalize())
            };
            let expected = origins.iter().chain(&corners).map(cosine).fold(0.0, f64::max);
            assert_relative_eq!(*value, expected, epsilon = 1e-12);
        }
    }

    #[test]
    fn a_configuration_that_makes_no_world_is_refused() {
        let mut config = config();
        config.colors.cross_width = 1.5;
        let refused = Environment::new(&config).unwrap_err().to_string();
        assert!(refused.contains("colors.cross_width"), "{refused}");
    }
}
