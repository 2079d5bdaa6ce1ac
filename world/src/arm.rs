//! A serial arm of six revolute joints: forward kinematics, Jacobian, limits. Which arm it is, says [`crate::hiro`].

use crate::scene::{Body, Color, Material};
use crate::shape::Shape;
use nalgebra::{Isometry3, Matrix6, UnitQuaternion, UnitVector3, Vector3, Vector6};

/// Joint angles \[rad\], or what has one number for each joint.
pub type JointVector = Vector6<f64>;

/// What the joints can do.
#[derive(Debug, Clone, PartialEq)]
pub struct JointLimits {
    /// Smallest angles \[rad\].
    pub lower: JointVector,
    /// Largest angles \[rad\].
    pub upper: JointVector,
    /// Largest speeds \[rad/s\].
    pub max_velocity: JointVector,
}

/// One revolute joint.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Joint {
    /// Frame of the joint at angle 0, in the frame of the joint before it (of the robot for the first).
    pub(crate) parent_from_joint: Isometry3<f64>,
    /// Axis in its own frame.
    pub(crate) axis: UnitVector3<f64>,
}

/// A serial arm with a hand at its end.
#[derive(Debug, Clone, PartialEq)]
pub struct Arm {
    pub(crate) joints: [Joint; 6],
    pub(crate) last_link_from_hand: Isometry3<f64>,
    pub(crate) limits: JointLimits,
    pub(crate) init: JointVector,
}

impl Arm {
    /// Frames of the six links, each turned by its joint.
    fn robot_from_links(&self, joints: &JointVector) -> [Isometry3<f64>; 6] {
        let mut robot_from_link = Isometry3::identity();
        std::array::from_fn(|i| {
            let Joint { parent_from_joint, axis } = &self.joints[i];
            robot_from_link *= parent_from_joint * UnitQuaternion::from_axis_angle(axis, joints[i]);
            robot_from_link
        })
    }

    /// Pose of the hand: forward kinematics.
    pub fn robot_from_hand(&self, joints: &JointVector) -> Isometry3<f64> {
        self.robot_from_links(joints)[5] * self.last_link_from_hand
    }

    /// Twist of the hand in the hand frame (translation first) per joint rate: the geometric Jacobian `J` of Eq. (6).
    pub fn jacobian(&self, joints: &JointVector) -> Matrix6<f64> {
        let links = self.robot_from_links(joints);
        let robot_from_hand = links[5] * self.last_link_from_hand;
        let hand_from_robot = robot_from_hand.rotation.inverse();
        let mut jacobian = Matrix6::zeros();
        for (i, robot_from_link) in links.iter().enumerate() {
            let axis = robot_from_link.rotation * self.joints[i].axis.into_inner();
            let lever = robot_from_hand.translation.vector - robot_from_link.translation.vector;
            jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(&(hand_from_robot * axis.cross(&lever)));
            jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(&(hand_from_robot * axis));
        }
        jacobian
    }

    /// Limits of the joints.
    pub fn limits(&self) -> &JointLimits {
        &self.limits
    }

    /// Are all angles within their limits, but for rounding (1e-9 rad)?
    pub fn within_limits(&self, joints: &JointVector) -> bool {
        let JointLimits { lower, upper, .. } = &self.limits;
        (0..6).all(|i| (lower[i] - 1e-9..=upper[i] + 1e-9).contains(&joints[i]))
    }

    /// The arm as plain solids, for an onlooker's view: balls at the joints, limbs between them.
    pub fn bodies(&self, joints: &JointVector, color: Color) -> Vec<Body> {
        let links = self.robot_from_links(joints);
        let at = |link: usize| links[link].translation.vector;
        let palm = self.robot_from_hand(joints).translation.vector;
        let (shoulder, elbow, wrist, flange) = (at(0), at(2), at(4), at(5));
        // Radii by eye, after photographs of the robot.
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

/// A cylinder from one point to another.
fn limb(from: &Vector3<f64>, to: &Vector3<f64>, radius: f64) -> (Shape, Isometry3<f64>) {
    let along = to - from;
    // None only for straight down, where upside down is as good.
    let rotation = UnitQuaternion::rotation_between(&Vector3::z(), &along)
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let shape = Shape::Cylinder { radius, half_height: along.norm() / 2.0 };
    (shape, Isometry3::from_parts(((from + to) / 2.0).into(), rotation))
}
