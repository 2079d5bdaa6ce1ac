//! Deflection: turns the desired motion toward a direction that the avoidance map admits (paper, Section 4.3).
//!
//! Measuring points are given in the robot's axes and motions in the hand frame. Directions are compared in the robot's axes.
//! Only the direction of the translation changes; its length and the rotation are kept.
//!
//! The paper leaves three points open:
//! - If no direction is admitted, the hand rotates but does not translate in this step, and the threshold rises.
//! - The threshold rises to a configured cap of at most 1. At 1 every direction is admitted, even one whose predicted value
//!   exceeds 1. The threshold never falls within a session.
//! - According to the text, a deadlock occurs when the value in the direction of the target falls below the threshold. In fact
//!   it occurs when the value stays above the threshold.

use crate::config::{DeflectionConfig, DeflectionMode};
use crate::error::{Error, Result};
use nalgebra::{UnitQuaternion, UnitVector3, Vector3};
use serde::{Deserialize, Serialize};
use world::{AvoidanceMap, MeasuringPoints, PoseChange};

/// Effect of deflection on the direction of a translation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DeflectionKind {
    /// Keeps the desired direction.
    Kept,
    /// Turns it to a measuring point.
    Turned,
    /// Cancels the translation, because no direction is admitted.
    Held,
}

/// A deflected motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deflection {
    /// `v̂_g`, a twist in the hand frame.
    pub motion: PoseChange,
    /// Effect on the direction.
    pub kind: DeflectionKind,
    /// The threshold `t_g` that was applied.
    pub threshold: f64,
}

/// Deflects motions. The threshold carries over from step to step.
#[derive(Debug, Clone)]
pub struct Deflector {
    points: MeasuringPoints,
    config: DeflectionConfig,
    threshold: f64,
}

impl Deflector {
    /// Creates a deflector with the threshold of the first step.
    pub fn new(config: &DeflectionConfig, points: &MeasuringPoints) -> Self {
        Self { points: points.clone(), config: config.clone(), threshold: config.threshold }
    }

    /// Deflects a desired motion, a twist in the hand frame. A deadlock raises the threshold for the next step.
    ///
    /// # Errors
    /// [`Error::MapSize`] unless the map has one value per measuring point.
    pub fn deflect(
        &mut self,
        desired: &PoseChange,
        map: &AvoidanceMap,
        robot_from_hand: &UnitQuaternion<f64>,
    ) -> Result<Deflection> {
        let (found, expected) = (map.values.len(), self.points.directions().len());
        if found != expected {
            return Err(Error::MapSize { found, expected });
        }
        let threshold = self.threshold;
        let wanted = robot_from_hand * desired.translation;
        if self.keeps(&wanted, map) {
            return Ok(Deflection { motion: *desired, kind: DeflectionKind::Kept, threshold });
        }
        let g_max = self.admitted(&wanted, map);
        self.raise(&wanted, g_max);
        let (direction, kind) =
            g_max.map_or((Vector3::zeros(), DeflectionKind::Held), |g| (*g, DeflectionKind::Turned));
        // Eq. (2): the length of the desired translation in the direction g_max, and the desired rotation.
        let translation = robot_from_hand.inverse() * direction * wanted.norm();
        Ok(Deflection { motion: PoseChange { translation, rotation: desired.rotation }, kind, threshold })
    }

    /// Returns `g_max`, the admitted measuring point closest to the desired direction. A point is admitted if its value is
    /// below the threshold.
    ///
    /// In mode `keep`, unlike in the paper, a detour must not lead lower than the desired direction: obstacles stand on the
    /// table, which is not in the map.
    fn admitted(&self, wanted: &Vector3<f64>, map: &AvoidanceMap) -> Option<UnitVector3<f64>> {
        let lowest = match self.config.mode {
            DeflectionMode::Paper => -1.0,
            DeflectionMode::Keep => wanted.z / wanted.norm(),
        };
        let points = self.points.directions().iter().zip(&map.values);
        let admitted = points.filter(|(g, value)| self.admits(**value) && g.z >= lowest).map(|(g, _)| *g);
        admitted.max_by(|a, b| a.dot(wanted).total_cmp(&b.dot(wanted)))
    }

    fn admits(&self, value: f64) -> bool {
        value < self.threshold || self.threshold >= 1.0
    }

    /// Returns whether the desired direction itself is admitted. Its value is that of the nearest measuring point.
    fn keeps(&self, wanted: &Vector3<f64>, map: &AvoidanceMap) -> bool {
        let points = self.points.directions().iter().zip(&map.values);
        let nearest = points.max_by(|(a, _), (b, _)| a.dot(wanted).total_cmp(&b.dot(wanted)));
        self.config.mode == DeflectionMode::Keep && nearest.is_some_and(|(_, value)| self.admits(*value))
    }

    /// Eq. (3): `t_g + ε` if `v_g · g_max ≤ 0`, else `t_g`; the paper prints equality in both cases.
    ///
    /// Beyond the paper, a direction also counts as a deadlock if it makes no more progress than a configured share of the
    /// translation.
    fn raise(&mut self, wanted: &Vector3<f64>, admitted: Option<UnitVector3<f64>>) {
        let DeflectionConfig { epsilon, max_threshold, min_progress, .. } = self.config;
        if admitted.is_none_or(|g_max| wanted.dot(&g_max) <= min_progress * wanted.norm()) {
            self.threshold = (self.threshold + epsilon).min(max_threshold);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn config(mode: DeflectionMode) -> DeflectionConfig {
        DeflectionConfig { mode, threshold: 0.5, epsilon: 0.1, max_threshold: 0.85, min_progress: 0.0 }
    }

    fn points() -> MeasuringPoints {
        MeasuringPoints::spiral(180)
    }

    /// Avoidance map of obstacles in the given directions.
    fn obstacles(directions: &[Vector3<f64>]) -> AvoidanceMap {
        let value =
            |g: &UnitVector3<f64>| directions.iter().map(|d| g.dot(&d.normalize())).fold(0.0, f64::max);
        AvoidanceMap { values: points().directions().iter().map(value).collect() }
    }

    fn forward() -> PoseChange {
        PoseChange::from_array([0.01, 0.0, 0.0, 0.1, -0.2, 0.3])
    }

    /// Deflects `forward` for a hand whose axes are those of the robot.
    fn deflect(deflector: &mut Deflector, map: &AvoidanceMap) -> Deflection {
        deflector.deflect(&forward(), map, &UnitQuaternion::identity()).unwrap()
    }

    #[test]
    fn with_nothing_in_the_way_keep_keeps_and_paper_takes_the_nearest_point() {
        let free = obstacles(&[]);
        let kept = deflect(&mut Deflector::new(&config(DeflectionMode::Keep), &points()), &free);
        assert_eq!((kept.motion, kept.kind), (forward(), DeflectionKind::Kept));

        let turned = deflect(&mut Deflector::new(&config(DeflectionMode::Paper), &points()), &free);
        let angle = turned.motion.translation.angle(&Vector3::x()).to_degrees();
        assert!(
            angle > 0.1 && angle < 11.1,
            "{angle}: x is not a measuring point, and the nearest one is closer than this"
        );
        assert_relative_eq!(turned.motion.translation.norm(), 0.01, epsilon = 1e-15);
        assert_eq!(turned.motion.rotation, forward().rotation);
    }

    #[test]
    fn an_obstacle_ahead_turns_the_motion_as_little_as_the_threshold_admits() {
        for mode in [DeflectionMode::Keep, DeflectionMode::Paper] {
            let map = obstacles(&[Vector3::x()]);
            let turned = deflect(&mut Deflector::new(&config(mode), &points()), &map);
            assert_eq!(turned.kind, DeflectionKind::Turned);
            // The threshold 0.5 is a cone of 60 degrees around the obstacle; points are at most 15.6 degrees apart.
            let angle = turned.motion.translation.angle(&Vector3::x()).to_degrees();
            assert!((60.0..67.0).contains(&angle), "{angle}");
            assert_relative_eq!(turned.motion.translation.norm(), 0.01, epsilon = 1e-15);
        }
    }

    #[test]
    fn an_obstacle_to_the_side_does_not_deflect() {
        let aside = obstacles(&[Vector3::new(0.1, 1.0, 0.0)]);
        let mut deflector = Deflector::new(&config(DeflectionMode::Keep), &points());
        assert_eq!(deflect(&mut deflector, &aside).kind, DeflectionKind::Kept);
    }

    #[test]
    fn directions_are_compared_in_the_axes_of_the_robot() {
        let map = obstacles(&[Vector3::x()]);
        let ahead_in_robot = Vector3::x() * 0.01;
        let in_robot = |robot_from_hand: UnitQuaternion<f64>| {
            let translation = robot_from_hand.inverse() * ahead_in_robot;
            let desired = PoseChange { translation, rotation: Vector3::zeros() };
            let mut deflector = Deflector::new(&config(DeflectionMode::Keep), &points());
            robot_from_hand * deflector.deflect(&desired, &map, &robot_from_hand).unwrap().motion.translation
        };
        let expected = in_robot(UnitQuaternion::identity());
        for yaw in [0.5, 1.5, 3.0] {
            let looking_down = UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, yaw);
            assert_relative_eq!(in_robot(looking_down), expected, epsilon = 1e-12);
        }
    }

    #[test]
    fn without_an_admitted_direction_the_hand_waits_and_the_threshold_rises() {
        let mut deflector = Deflector::new(&config(DeflectionMode::Keep), &points());
        let walled_in = AvoidanceMap { values: vec![0.75; 180] };
        for threshold in [0.5, 0.6, 0.7] {
            let held = deflect(&mut deflector, &walled_in);
            assert_eq!((held.kind, held.motion.translation), (DeflectionKind::Held, Vector3::zeros()));
            assert_eq!(held.motion.rotation, forward().rotation);
            assert_relative_eq!(held.threshold, threshold, epsilon = 1e-12);
        }
        assert_eq!(deflect(&mut deflector, &walled_in).kind, DeflectionKind::Kept);
    }

    #[test]
    fn a_way_back_raises_the_threshold_up_to_its_cap_and_a_way_forward_does_not() {
        let mut deflector = Deflector::new(&config(DeflectionMode::Paper), &points());
        // Everything except the way back is blocked at any threshold.
        let behind = |g: &UnitVector3<f64>| if g.x < -0.5 { 0.0 } else { 0.9 };
        let dead_end = AvoidanceMap { values: points().directions().iter().map(behind).collect() };
        let thresholds: Vec<f64> = (0..6).map(|_| deflect(&mut deflector, &dead_end).threshold).collect();
        for (threshold, expected) in thresholds.iter().zip([0.5, 0.6, 0.7, 0.8, 0.85, 0.85]) {
            assert_relative_eq!(*threshold, expected, epsilon = 1e-12);
        }
        let mut deflector = Deflector::new(&config(DeflectionMode::Paper), &points());
        let ahead = obstacles(&[Vector3::x()]);
        assert!((0..6).all(|_| deflect(&mut deflector, &ahead).threshold < 0.55));
    }

    #[test]
    fn little_progress_can_count_as_a_deadlock() {
        let strict = DeflectionConfig { min_progress: 0.6, ..config(DeflectionMode::Keep) };
        let mut deflector = Deflector::new(&strict, &points());
        // 60 degrees or more off the desired direction: cosine of at most 0.5.
        let ahead = obstacles(&[Vector3::x()]);
        assert_relative_eq!(deflect(&mut deflector, &ahead).threshold, 0.5);
        assert_relative_eq!(deflect(&mut deflector, &ahead).threshold, 0.6);
    }

    #[test]
    fn a_detour_does_not_lead_lower_than_the_wanted_way() {
        let above = obstacles(&[Vector3::new(1.0, 0.0, 0.3)]);
        let rise = |mode| deflect(&mut Deflector::new(&config(mode), &points()), &above).motion.translation.z;
        assert!(rise(DeflectionMode::Paper) < 0.0, "as printed, under the obstacle");
        assert!(rise(DeflectionMode::Keep) >= 0.0);
    }

    #[test]
    fn a_map_of_another_size_is_refused() {
        let mut deflector = Deflector::new(&config(DeflectionMode::Keep), &points());
        let short = AvoidanceMap { values: vec![0.0; 7] };
        let refused = deflector.deflect(&forward(), &short, &UnitQuaternion::identity());
        assert!(matches!(refused, Err(Error::MapSize { found: 7, expected: 180 })));
    }

    #[test]
    fn at_a_threshold_of_1_every_direction_is_admitted() {
        let open = DeflectionConfig { threshold: 1.0, max_threshold: 1.0, ..config(DeflectionMode::Keep) };
        let mut deflector = Deflector::new(&open, &points());
        assert_eq!(
            deflect(&mut deflector, &AvoidanceMap { values: vec![1.1; 180] }).kind,
            DeflectionKind::Kept
        );
    }
}
