//! The hand's solid parts: a palm and two open fingers, as boxes. They collide, and their edges carry the reference points
//! of the paper's Section 4.2.

use crate::config::HandConfig;
use crate::geometry::{distance, overlap};
use crate::scene::{Body, Color, Material, Scene};
use crate::shape::Shape;
use crate::units::mm;
use nalgebra::{Isometry3, Point3, Vector3};

/// Palm and fingers in the hand frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Hand {
    /// Half of the sides, and the centre, of the palm and of each finger.
    boxes: [(Vector3<f64>, Vector3<f64>); 3],
    reference_points: [Point3<f64>; 6],
}

/// What the hand touches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Contacts {
    /// A part of the hand is below the table's surface.
    pub table: bool,
    /// The target.
    pub target: bool,
    /// One obstacle at least.
    pub obstacle: bool,
}

impl Contacts {
    /// Is there any?
    pub fn any(self) -> bool {
        self.table || self.target || self.obstacle
    }
}

impl Hand {
    /// From the configuration: the palm lies behind the plane z = 0, the fingers stand on it at ±y.
    pub fn new(config: &HandConfig) -> Self {
        let palm = Vector3::from(config.palm_mm.map(mm)) / 2.0;
        let finger = Vector3::from(config.finger_mm.map(mm)) / 2.0;
        let aside = mm(config.opening_mm) / 2.0 + finger.y;
        let boxes = [
            (palm, Vector3::new(0.0, 0.0, -palm.z)),
            (finger, Vector3::new(0.0, aside, finger.z)),
            (finger, Vector3::new(0.0, -aside, finger.z)),
        ];
        let (tip, outside) = (2.0 * finger.z, aside + finger.y);
        let reference_points = [
            [0.0, outside, tip],
            [0.0, -outside, tip],
            [palm.x, palm.y, 0.0],
            [palm.x, -palm.y, 0.0],
            [-palm.x, palm.y, 0.0],
            [-palm.x, -palm.y, 0.0],
        ];
        Self { boxes, reference_points: reference_points.map(Point3::from) }
    }

    /// Palm and fingers in the robot's space.
    pub fn bodies(&self, robot_from_hand: &Isometry3<f64>, color: Color) -> Vec<Body> {
        let material = Material { color, cross: None, texture: None };
        let body = |&(half_extents, center): &(Vector3<f64>, Vector3<f64>)| Body {
            shape: Shape::Cuboid { half_extents },
            robot_from_body: robot_from_hand * Isometry3::from(center),
            material,
        };
        self.boxes.iter().map(body).collect()
    }

    /// Points on the hand's edges from which obstacles are looked at as well as from its centre, in the hand frame: the
    /// outer ends of the two fingertips and the four corners of the palm's front face. The paper says "on the edges of the
    /// hand" and no more.
    pub fn reference_points(&self) -> &[Point3<f64>] {
        &self.reference_points
    }

    /// What the hand touches. The table counts as endless.
    pub fn contacts(&self, robot_from_hand: &Isometry3<f64>, scene: &Scene) -> Contacts {
        let parts = self.bodies(robot_from_hand, scene.background);
        let touches = |body: &Body| parts.iter().any(|part| overlap(part, body));
        Contacts {
            table: parts.iter().any(|part| lowest(part) < scene.table.height()),
            target: touches(&scene.target),
            obstacle: scene.obstacles.iter().any(touches),
        }
    }

    /// Distance to the nearest obstacle \[m\]: 0 in contact, infinite where there is none.
    pub fn clearance(&self, robot_from_hand: &Isometry3<f64>, scene: &Scene) -> f64 {
        let parts = self.bodies(robot_from_hand, scene.background);
        let to_parts =
            |obstacle: &Body| parts.iter().map(|part| distance(part, obstacle)).fold(f64::INFINITY, f64::min);
        scene.obstacles.iter().map(to_parts).fold(f64::INFINITY, f64::min)
    }
}

/// Height of a box's lowest corner in the robot frame \[m\].
fn lowest(part: &Body) -> f64 {
    let up = part.robot_from_body.rotation.inverse_transform_vector(&Vector3::z());
    part.robot_from_body.translation.z - up.abs().dot(&part.shape.half_extents())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{LightConfig, TableConfig};
    use crate::pose::HandPose;
    use crate::scene::{Light, Table};
    use approx::assert_relative_eq;

    /// Palm 60 x 124 x 70 mm, fingers 20 x 12 x 70 mm, 100 mm apart.
    fn hand() -> Hand {
        Hand::new(&HandConfig {
            palm_mm: [60.0, 124.0, 70.0],
            finger_mm: [20.0, 12.0, 70.0],
            opening_mm: 100.0,
        })
    }

    /// A hand that looks straight down from a height above the origin, turned about the vertical.
    fn above(height: f64, yaw: f64) -> Isometry3<f64> {
        let (position, angles) = (Vector3::new(0.0, 0.0, height), Vector3::new(0.0, 0.0, yaw));
        HandPose { position, angles }.robot_from_hand()
    }

    fn cuboid(sides: [f64; 3], center: [f64; 3]) -> Body {
        Body {
            shape: Shape::Cuboid { half_extents: Vector3::from(sides) / 2.0 },
            robot_from_body: Isometry3::translation(center[0], center[1], center[2]),
            material: Material { color: [0.5; 3], cross: None, texture: None },
        }
    }

    /// A target of 40 mm in the middle of a table at height 0, and obstacles.
    fn scene(obstacles: Vec<Body>) -> Scene {
        let table = TableConfig { center_mm: [0.0; 3], size_mm: [1000.0; 2], color: [0.5; 3] };
        Scene {
            table: Table::new(&table),
            target: cuboid([0.04; 3], [0.0, 0.0, 0.02]),
            obstacles,
            light: Light::new(&LightConfig { towards_light: [0.0, 0.0, 1.0], ambient: 0.5 }),
            background: [0.0; 3],
        }
    }

    #[test]
    fn open_fingers_stand_beside_the_target_without_touching_it() {
        // 80 mm above the target's centre, where the paper grasps.
        let free = hand().contacts(&above(0.10, 0.0), &scene(vec![]));
        assert_eq!(free, Contacts { table: false, target: false, obstacle: false });
        assert!(!free.any());
        assert!(hand().contacts(&above(0.039, 0.0), &scene(vec![])).target, "palm on the target");
    }

    #[test]
    fn fingertips_reach_the_table_70_mm_ahead_of_the_palm() {
        assert!(!hand().contacts(&above(0.0701, 0.0), &scene(vec![])).table);
        assert!(hand().contacts(&above(0.0699, 0.0), &scene(vec![])).table);
        // Rolled by 5 degrees, the outer end of a fingertip is 62 sin 5 mm lower, and 70 (1 - cos 5) mm higher.
        let roll = 5f64.to_radians();
        let reach = 0.070 * roll.cos() + 0.062 * roll.sin();
        let rolled = |height| {
            let (position, angles) = (Vector3::new(0.0, 0.0, height), Vector3::new(roll, 0.0, 0.0));
            hand().contacts(&HandPose { position, angles }.robot_from_hand(), &scene(vec![])).table
        };
        assert!(rolled(reach - 1e-6) && !rolled(reach + 1e-6));
    }

    #[test]
    fn clearance_is_the_gap_beside_the_outer_finger() {
        // The outer face of a finger is 62 mm from the middle, along the robot's y; the post's face is at 72 mm.
        let post = cuboid([0.02, 0.02, 0.2], [0.0, 0.082, 0.1]);
        let beside = scene(vec![cuboid([0.02; 3], [0.5, 0.0, 0.01]), post]);
        assert_relative_eq!(hand().clearance(&above(0.1, 0.0), &beside), 0.010, epsilon = 1e-9);
        assert!(!hand().contacts(&above(0.1, 0.0), &beside).obstacle);
        // A quarter turn takes the fingers away; the palm's face at 30 mm is then the nearest.
        let turned = above(0.1, std::f64::consts::FRAC_PI_2);
        assert_relative_eq!(hand().clearance(&turned, &beside), 0.042, epsilon = 1e-9);
        assert!(hand().clearance(&turned, &scene(vec![])).is_infinite());
    }

    #[test]
    fn a_sphere_is_touched_where_it_is_round() {
        let ball = |radius: f64, center: [f64; 3]| Body {
            shape: Shape::Sphere { radius },
            ..cuboid([0.0; 3], center)
        };
        // The outer edge of the tip of a finger is 62 mm aside and at a height of 30 mm; the ball's centre 30 mm further and
        // 40 mm lower.
        let beside = scene(vec![ball(0.045, [0.0, 0.092, -0.01])]);
        assert_relative_eq!(hand().clearance(&above(0.1, 0.0), &beside), 0.005, epsilon = 1e-9);
        assert!(!hand().contacts(&above(0.1, 0.0), &beside).obstacle);
        assert!(hand().contacts(&above(0.1, 0.0), &scene(vec![ball(0.0501, [0.0, 0.092, -0.01])])).obstacle);
        // Between the fingers, under the palm.
        let on_ball = |height| {
            let target = ball(0.03, [0.0, 0.0, 0.03]);
            hand().contacts(&above(height, 0.0), &Scene { target, ..scene(vec![]) }).target
        };
        assert!(on_ball(0.0599) && !on_ball(0.0601));
    }

    #[test]
    fn contact_with_an_obstacle_is_no_clearance() {
        let under_the_finger = scene(vec![cuboid([0.02; 3], [0.0, -0.056, 0.031])]);
        let contacts = hand().contacts(&above(0.11, 0.0), &under_the_finger);
        assert_eq!(contacts, Contacts { table: false, target: false, obstacle: true });
        assert_relative_eq!(hand().clearance(&above(0.11, 0.0), &under_the_finger), 0.0);
    }

    #[test]
    fn reference_points_are_corners_or_edges_of_the_drawn_parts() {
        let hand = hand();
        let parts = hand.bodies(&Isometry3::identity(), [0.5; 3]);
        assert_eq!(parts.len(), 3);
        for point in hand.reference_points() {
            // On an edge, two coordinates or more are at their ends.
            let at_ends = |part: &Body| {
                let inside = part.robot_from_body.inverse_transform_point(point).coords.abs();
                (inside - part.shape.half_extents()).iter().filter(|gap| gap.abs() < 1e-12).count()
            };
            assert!(parts.iter().any(|part| at_ends(part) >= 2), "{point}");
        }
        let widest = hand.reference_points().iter().map(|point| point.y.abs()).fold(0.0, f64::max);
        assert_relative_eq!(widest, 0.062, epsilon = 1e-12);
    }
}
