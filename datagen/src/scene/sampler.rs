//! Bounded rejection sampling of scenes and hand poses (paper, Section 6.2).

use super::placement::{HandPlacement, Placement};
use super::pose_range::PoseRange;
use super::random::uniform;
use super::rejection::{Reason, Rejections};
use crate::config::{MotionConfig, ObstacleConfig, Obstruction, RejectionConfig, ShapeName, TargetConfig};
use nalgebra::{Isometry3, Point2, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;
use world::config::CameraConfig;
use world::environment::Environment;
use world::geometry;
use world::pose::HandPose;
use world::units::{deg, mm};
use world::{Camera, Renderer, Scene, Shape, Table};

/// Draws placements that satisfy a configuration.
#[derive(Clone)]
pub struct Sampler<'a> {
    environment: &'a Environment,
    camera: Camera,
    target: &'a TargetConfig,
    obstacles: &'a ObstacleConfig,
    motions: &'a [MotionConfig],
    rejection: &'a RejectionConfig,
}

impl<'a> Sampler<'a> {
    /// Creates a sampler from validated parts of a configuration.
    pub fn new(
        environment: &'a Environment,
        target: &'a TargetConfig,
        obstacles: &'a ObstacleConfig,
        motions: &'a [MotionConfig],
        rejection: &'a RejectionConfig,
    ) -> Self {
        let camera = environment.camera.clone();
        Self { environment, camera, target, obstacles, motions, rejection }
    }

    /// Replaces the mount of the camera.
    #[must_use]
    pub fn mounted(mut self, hand_from_camera: &Isometry3<f64>) -> Self {
        self.camera.hand_from_camera = *hand_from_camera;
        self
    }

    /// Draws a placement, with at most `rejection.tries` attempts.
    ///
    /// The motion and the number of obstacles are drawn once, so that rejection does not change their distributions.
    /// Everything else is redrawn in each attempt.
    pub fn draw(&self, rng: &mut ChaCha8Rng) -> Result<Placement, Rejections> {
        let motion = self.motion(rng);
        let [from, to] = self.obstacles.count;
        let count = rng.random_range(from..=to);
        let mut rejections = Rejections::default();
        for _ in 0..self.rejection.tries {
            match self.attempt(motion, count, rng) {
                Ok(placement) => return Ok(placement),
                Err(reason) => rejections.add(reason),
            }
        }
        Err(rejections)
    }

    fn motion(&self, rng: &mut ChaCha8Rng) -> usize {
        let draw = rng.random::<f64>();
        let mut upper = 0.0;
        let drawn = self.motions.iter().position(|motion| {
            upper += motion.share;
            draw < upper
        });
        // Rounding can leave the sum of the shares just below 1.
        drawn.unwrap_or(self.motions.len() - 1)
    }

    fn attempt(&self, motion: usize, obstacles: u32, rng: &mut ChaCha8Rng) -> Result<Placement, Reason> {
        let environment = self.environment;
        let (target, yaw) = self.draw_target(rng);
        let center = target.1.translation.vector.into();
        let turn = if self.target.hand_follows_yaw { yaw } else { 0.0 };
        let ranges = self.motions[motion].ranges().map(PoseRange::new);
        let poses: Vec<HandPose> = ranges.map(|range| range.sample(&center, turn, rng)).collect();
        let hands: Vec<Isometry3<f64>> = poses.iter().map(HandPose::robot_from_hand).collect();
        // The cheap checks come first.
        if !hands.iter().all(|robot_from_hand| self.camera.sees(robot_from_hand, &center)) {
            return Err(Reason::OutOfSight);
        }
        let around = poses[poses.len() - 1].position.xy().into();
        let obstacles = (0..obstacles).map(|_| self.draw_obstacle(&around, rng)).collect();
        let scene = environment.scene(target, obstacles);
        self.check_gaps(&scene)?;
        for robot_from_hand in &hands {
            self.check_contacts(robot_from_hand, &scene)?;
        }
        let mut placed = Vec::with_capacity(hands.len());
        for (pose, robot_from_hand) in poses.into_iter().zip(&hands) {
            self.check_visibility(robot_from_hand, &scene)?;
            let joints = environment.arm.joints_for(robot_from_hand).ok_or(Reason::Unreachable)?;
            placed.push(HandPlacement { pose, joints });
        }
        Ok(Placement { motion, scene, hands: placed })
    }

    /// Draws the target with its pose, and returns its yaw as well.
    fn draw_target(&self, rng: &mut ChaCha8Rng) -> ((Shape, Isometry3<f64>), f64) {
        let config = self.target;
        let sides = [config.short_side_mm, config.long_side_mm, config.height_mm];
        let shape = draw_shape(&config.shapes, sides, rng);
        let place = Point2::new(mm(uniform(config.x_mm, rng)), mm(uniform(config.y_mm, rng)));
        let yaw = deg(uniform(config.yaw_deg, rng));
        ((shape, self.on_table(&shape, &place, yaw)), yaw)
    }

    fn draw_obstacle(&self, around: &Point2<f64>, rng: &mut ChaCha8Rng) -> (Shape, Isometry3<f64>) {
        let config = self.obstacles;
        let sides = [config.short_side_mm, config.long_side_mm, config.height_mm];
        let shape = draw_shape(&config.shapes, sides, rng);
        let distance = mm(uniform(config.distance_mm, rng));
        let (sin, cos) = libm::sincos(uniform([0.0, TAU], rng));
        let yaw = deg(uniform(config.yaw_deg, rng));
        (shape, self.on_table(&shape, &(around + Vector2::new(cos, sin) * distance), yaw))
    }

    /// Returns the pose of a body standing on the table.
    fn on_table(&self, shape: &Shape, place: &Point2<f64>, yaw: f64) -> Isometry3<f64> {
        let height = Table::new(&self.environment.config.table).height() + shape.half_extents().z;
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        Isometry3::from_parts(Translation3::new(place.x, place.y, height), rotation)
    }

    fn check_gaps(&self, scene: &Scene) -> Result<(), Reason> {
        let gap = mm(self.obstacles.gap_mm);
        for (i, obstacle) in scene.obstacles.iter().enumerate() {
            let mut others = std::iter::once(&scene.target).chain(&scene.obstacles[..i]);
            if others.any(|other| geometry::distance(obstacle, other) < gap) {
                return Err(Reason::Crowded);
            }
        }
        Ok(())
    }

    fn check_contacts(&self, robot_from_hand: &Isometry3<f64>, scene: &Scene) -> Result<(), Reason> {
        let contacts = self.environment.hand.contacts(robot_from_hand, scene);
        for &obstruction in &self.rejection.clear_of {
            let (touched, reason) = match obstruction {
                Obstruction::Table => (contacts.table, Reason::TouchesTable),
                Obstruction::Obstacles => (contacts.obstacle, Reason::TouchesObstacle),
                Obstruction::Target => (contacts.target, Reason::TouchesTarget),
            };
            if touched {
                return Err(reason);
            }
        }
        Ok(())
    }

    fn check_visibility(&self, robot_from_hand: &Isometry3<f64>, scene: &Scene) -> Result<(), Reason> {
        let renderer = Renderer::new(low_resolution(&self.camera, &self.environment.config.camera));
        let robot_from_camera = robot_from_hand * self.camera.hand_from_camera;
        let visible = renderer.pixels_of(TARGET, scene, &robot_from_camera);
        let Camera { width, height, .. } = renderer.camera();
        let enough = visible as f64 >= self.rejection.min_target_area * f64::from(width * height);
        if enough { Ok(()) } else { Err(Reason::HardlyVisible) }
    }
}

/// Width of the images in which the area of the target is measured. A fixed, low resolution is fast, and makes the scenes
/// independent of the resolution of the dataset.
const VISIBILITY_WIDTH: u32 = 64;

/// Returns the low-resolution camera with the same view.
fn low_resolution(camera: &Camera, config: &CameraConfig) -> Camera {
    let height = (VISIBILITY_WIDTH * config.height / config.width).max(1);
    let low = Camera::new(&CameraConfig { width: VISIBILITY_WIDTH, height, ..config.clone() });
    Camera { hand_from_camera: camera.hand_from_camera, ..low }
}

/// Number of the target in an instance map.
const TARGET: u16 = 1;

/// Draws a shape; the sides are `[short side, long side, height]`.
fn draw_shape(shapes: &[ShapeName], [short, long, height]: [[f64; 2]; 3], rng: &mut ChaCha8Rng) -> Shape {
    let name = shapes[rng.random_range(0..shapes.len())];
    let short = uniform(short, rng);
    let long = uniform([long[0].max(short), long[1]], rng);
    let [half_short, half_long, half_height] = [short, long, uniform(height, rng)].map(|side| mm(side) / 2.0);
    match name {
        ShapeName::Cuboid => Shape::Cuboid { half_extents: Vector3::new(half_long, half_short, half_height) },
        ShapeName::Cylinder => Shape::Cylinder { radius: half_short, half_height },
        ShapeName::Sphere => Shape::Sphere { radius: half_short },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DatasetConfig;
    use crate::fixture;
    use crate::scene::stream;
    use world::units::to_mm;

    fn draws(config: &DatasetConfig, count: u64) -> Vec<Placement> {
        let environment = Environment::new(&config.world).unwrap();
        let DatasetConfig { target, obstacles, motions, rejection, .. } = config;
        let sampler = Sampler::new(&environment, target, obstacles, motions, rejection);
        (0..count).map(|index| sampler.draw(&mut stream(config.seed, index)).unwrap()).collect()
    }

    #[test]
    fn draws_satisfy_the_configuration() {
        let config = fixture::config("c", 1);
        let environment = Environment::new(&config.world).unwrap();
        for placement in draws(&config, 40) {
            let Placement { scene, hands, .. } = &placement;
            for hand in hands {
                let robot_from_hand = hand.pose.robot_from_hand();
                assert!(!environment.hand.contacts(&robot_from_hand, scene).any());
                let reached = environment.arm.robot_from_hand(&hand.joints);
                assert!((reached.translation.vector - hand.pose.position).norm() < 1e-6);
                assert!(reached.rotation.angle_to(&robot_from_hand.rotation) < 1e-6);
                assert!(environment.arm.within_limits(&hand.joints));
            }
            assert!((1..=3).contains(&scene.obstacles.len()));
            for body in scene.bodies() {
                let bottom = body.robot_from_body.translation.z - body.shape.half_extents().z;
                assert!((bottom - scene.table.height()).abs() < 1e-12);
            }
            for obstacle in &scene.obstacles {
                let away = (obstacle.robot_from_body.translation.vector - hands[1].pose.position).xy().norm();
                assert!((70.0..=120.0).contains(&to_mm(away)), "{away}");
                assert!(to_mm(geometry::distance(obstacle, &scene.target)) >= 5.0);
            }
        }
    }

    #[test]
    fn sizes_follow_the_paper() {
        for placement in draws(&fixture::config("b", 1), 60) {
            let target = placement.scene.target;
            let [x, y, z] = target.shape.half_extents().map(|half| to_mm(2.0 * half)).into();
            assert!((30.0..=60.0).contains(&y) && (20.0..=60.0).contains(&z), "{y} {z}");
            match target.shape {
                Shape::Cuboid { .. } => assert!(x >= y && (40.0..=150.0).contains(&x), "{x} {y}"),
                _ => assert!((x - y).abs() < 1e-9, "{x} {y}"),
            }
        }
    }

    #[test]
    fn the_same_scenes_are_drawn_at_any_resolution() {
        let mut fine = fixture::config("c", 1);
        let coarse = draws(&fine, 5);
        (fine.world.camera.width, fine.world.camera.height) = (80, 60);
        assert_eq!(draws(&fine, 5), coarse);
    }

    #[test]
    fn rejection_shifts_neither_motions_nor_the_number_of_obstacles() {
        let mut config = fixture::config("avoid", 1);
        config.obstacles.count = [0, 1];
        let placements = draws(&config, 200);
        let share = |holds: fn(&Placement) -> bool| placements.iter().filter(|&p| holds(p)).count();
        // Four standard deviations of 200 fair coins are 28.
        assert!((72..=128).contains(&share(|p| p.motion == 0)));
        assert!((72..=128).contains(&share(|p| p.scene.obstacles.is_empty())));
    }

    #[test]
    fn a_scene_that_cannot_be_placed_is_an_error_with_the_reason() {
        let refused = |change: fn(&mut DatasetConfig)| {
            let mut config = fixture::config("c", 1);
            config.rejection.tries = 50;
            change(&mut config);
            let environment = Environment::new(&config.world).unwrap();
            let DatasetConfig { target, obstacles, motions, rejection, .. } = &config;
            let sampler = Sampler::new(&environment, target, obstacles, motions, rejection);
            sampler.draw(&mut stream(0, 0)).unwrap_err()
        };
        let far = refused(|c| (c.target.x_mm, c.obstacles.count) = ([900.0, 950.0], [0, 0]));
        assert!(far.of(Reason::Unreachable) > 0 && far.total() == 50, "{far}");
        assert!(far.to_string().contains("out of the arm's reach (target.x_mm"), "{far}");
        let crowded = refused(|c| (c.obstacles.count, c.obstacles.gap_mm) = ([3, 3], 200.0));
        assert!(crowded.of(Reason::Crowded) > 25, "{crowded}");
        let low = refused(|c| c.motions.iter_mut().for_each(|motion| motion.current.reference_mm = 20.0));
        assert!(low.of(Reason::TouchesTable) > 0, "{low}");
        let small = refused(|c| c.rejection.min_target_area = 0.99);
        assert!(small.of(Reason::HardlyVisible) > 0, "{small}");
    }
}
