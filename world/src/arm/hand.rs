//! The solid parts of the hand: a palm and two open fingers, as boxes. They are used for collisions, and their edges carry the
//! reference points of the paper's Section 4.2.

use crate::color::Color;
use crate::config::HandConfig;
use crate::geometry::{distance, overlap};
use crate::scene::{Body, Material, Scene, Shape};
use crate::units::mm;
use nalgebra::{Isometry3, Point3, Vector3};

/// Palm and fingers in the hand frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Hand {
    /// Half of the sides, and the center, of the palm and of each finger.
    boxes: [(Vector3<f64>, Vector3<f64>); 3],
    reference_points: [Point3<f64>; 6],
}

/// Contacts of the hand with a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Contacts {
    /// Whether a part of the hand is below the table top.
    pub table: bool,
    /// Whether the hand touches the target.
    pub target: bool,
    /// Whether the hand touches an obstacle.
    pub obstacle: bool,
}

impl Contacts {
    /// Returns whether there is any contact.
    pub fn any(self) -> bool {
        self.table || self.target || self.obstacle
    }
}

impl Hand {
    /// Creates the hand that a configuration describes. The palm lies behind the plane z = 0, with the fingers on it at ±y.
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

    /// Returns palm and fingers in the robot frame.
    pub fn bodies(&self, robot_from_hand: &Isometry3<f64>, color: Color) -> Vec<Body> {
        let material = Material { color, cross: None, texture: None };
        let body = |&(half_extents, center): &(Vector3<f64>, Vector3<f64>)| Body {
            shape: Shape::Cuboid { half_extents },
            robot_from_body: robot_from_hand * Isometry3::from(center),
            material,
        };
        self.boxes.iter().map(body).collect()
    }

    /// Returns the points from which obstacles are viewed in addition to the center of the hand, in the hand frame: the outer
    /// ends of the two fingertips and the four corners of the front face of the palm. The paper specifies only "on the edges of
    /// the hand".
    pub fn reference_points(&self) -> &[Point3<f64>] {
        &self.reference_points
    }

    /// Finds the contacts of the hand at a pose. The table counts as infinite.
    pub fn contacts(&self, robot_from_hand: &Isometry3<f64>, scene: &Scene) -> Contacts {
        let parts = self.bodies(robot_from_hand, scene.background);
        let touches = |body: &Body| parts.iter().any(|part| overlap(part, body));
        Contacts {
            table: parts.iter().any(|part| part.lowest() < scene.table.height()),
            target: touches(&scene.target),
            obstacle: scene.obstacles.iter().any(touches),
        }
    }

    /// Returns the distance to the nearest obstacle \[m\]: 0 in contact, infinite if there are no obstacles.
    pub fn clearance(&self, robot_from_hand: &Isometry3<f64>, scene: &Scene) -> f64 {
        let parts = self.bodies(robot_from_hand, scene.background);
        let to_parts =
            |obstacle: &Body| parts.iter().map(|part| distance(part, obstacle)).fold(f64::INFINITY, f64::min);
        scene.obstacles.iter().map(to_parts).fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{block, body, scene};
    use crate::pose::HandPose;
    use approx::assert_relative_eq;

    /// Palm: 60 x 124 x 70 mm. Fingers: 20 x 12 x 70 mm, 100 mm apart.
    fn hand() -> Hand {
        Hand::new(&HandConfig {
            palm_mm: [60.0, 124.0, 70.0],
            finger_mm: [20.0, 12.0, 70.0],
            opening_mm: 100.0,
        })
    }

    /// A hand that looks straight down from a height above the origin, turned about the vertical axis.
    fn above(height: f64, yaw: f64) -> Isometry3<f64> {
        let (position, angles) = (Vector3::new(0.0, 0.0, height), Vector3::new(0.0, 0.0, yaw));
        HandPose { position, angles }.robot_from_hand()
    }

    #[test]
    fn open_fingers_stand_beside_the_target_without_touching_it() {
        // 80 mm above the center of the target, where the paper grasps.
        let free = hand().contacts(&above(0.10, 0.0), &scene(vec![]));
        assert_eq!(free, Contacts { table: false, target: false, obstacle: false });
        assert!(!free.any());
        assert!(hand().contacts(&above(0.039, 0.0), &scene(vec![])).target, "palm on the target");
    }

    #[test]
    fn fingertips_reach_the_table_70_mm_ahead_of_the_palm() {
        assert!(!hand().contacts(&above(0.0701, 0.0), &scene(vec![])).table);
        assert!(hand().contacts(&above(0.0699, 0.0), &scene(vec![])).table);
        // A roll of 5 degrees lowers the outer end of a fingertip by 62 sin 5 mm and raises it by 70 (1 - cos 5) mm.
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
        // Along the robot's y axis, the outer face of a finger is 62 mm from the middle, and the face of the post 72 mm.
        let post = block([0.02, 0.02, 0.2], [0.0, 0.082, 0.1]);
        let beside = scene(vec![block([0.02; 3], [0.5, 0.0, 0.01]), post]);
        assert_relative_eq!(hand().clearance(&above(0.1, 0.0), &beside), 0.010, epsilon = 1e-9);
        assert!(!hand().contacts(&above(0.1, 0.0), &beside).obstacle);
        // After a quarter turn the face of the palm, at 30 mm, is nearest.
        let turned = above(0.1, std::f64::consts::FRAC_PI_2);
        assert_relative_eq!(hand().clearance(&turned, &beside), 0.042, epsilon = 1e-9);
        assert!(hand().clearance(&turned, &scene(vec![])).is_infinite());
    }

    #[test]
    fn a_sphere_is_touched_where_it_is_round() {
        let ball = |radius: f64, center: [f64; 3]| body(Shape::Sphere { radius }, center, [0.0; 3]);
        // The outer edge of a fingertip is 62 mm from the middle, at a height of 30 mm. The center of the ball is 30 mm farther
        // out and 40 mm lower.
        let beside = scene(vec![ball(0.045, [0.0, 0.092, -0.01])]);
        assert_relative_eq!(hand().clearance(&above(0.1, 0.0), &beside), 0.005, epsilon = 1e-9);
        assert!(!hand().contacts(&above(0.1, 0.0), &beside).obstacle);
        assert!(hand().contacts(&above(0.1, 0.0), &scene(vec![ball(0.0501, [0.0, 0.092, -0.01])])).obstacle);
        // A ball between the fingers, under the palm.
        let on_ball = |height| {
            let target = ball(0.03, [0.0, 0.0, 0.03]);
            hand().contacts(&above(height, 0.0), &Scene { target, ..scene(vec![]) }).target
        };
        assert!(on_ball(0.0599) && !on_ball(0.0601));
    }

    #[test]
    fn clearance_is_zero_in_contact_with_an_obstacle() {
        let under_the_finger = scene(vec![block([0.02; 3], [0.0, -0.056, 0.031])]);
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
            // On an edge, at least two coordinates are at their ends.
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
