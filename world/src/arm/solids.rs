//! The arm as solids, for views from outside.

use crate::arm::kinematics::{Arm, JointVector};
use crate::color::Color;
use crate::scene::{Body, Material, Shape};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

impl Arm {
    /// Returns the arm as plain solids: balls at the joints and cylinders between them.
    pub fn bodies(&self, joints: &JointVector, color: Color) -> Vec<Body> {
        let links = self.robot_from_links(joints);
        let at = |link: usize| links[link].translation.vector;
        let palm = self.robot_from_hand(joints).translation.vector;
        let (shoulder, elbow, wrist, flange) = (at(0), at(2), at(4), at(5));
        // Radii estimated from photographs of the robot.
        let solids = [
            ball(&shoulder, 0.055),
            limb(&shoulder, &elbow, 0.045),
            ball(&elbow, 0.050),
            limb(&elbow, &wrist, 0.040),
            ball(&wrist, 0.042),
            limb(&wrist, &flange, 0.035),
            limb(&flange, &palm, 0.030),
        ];
        let material = Material { color, cross: None, texture: None };
        solids.map(|(shape, robot_from_body)| Body { shape, robot_from_body, material }).into()
    }
}

fn ball(center: &Vector3<f64>, radius: f64) -> (Shape, Isometry3<f64>) {
    (Shape::Sphere { radius }, Isometry3::translation(center.x, center.y, center.z))
}

/// Creates a cylinder from one point to another.
fn limb(from: &Vector3<f64>, to: &Vector3<f64>, radius: f64) -> (Shape, Isometry3<f64>) {
    let along = to - from;
    // `None` only if the cylinder points straight down; then it is turned upside down.
    let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &along)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let shape = Shape::Cylinder { radius, half_height: along.norm() / 2.0 };
    (shape, Isometry3::from_parts(((from + to) / 2.0).into(), rotation))
}
