//! Hand poses as six numbers, and the change between two of them: the label of `CNN_approach` (paper, Section 4.1).

use nalgebra::{Isometry3, Matrix3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// A hand pose in the paper's six numbers: position in the robot frame, and the angles `φ θ ψ` about the robot's x, y and z
/// axes, applied in that order to a hand that looks straight down.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct HandPose {
    /// Palm centre in the robot frame \[m\].
    pub position: Vector3<f64>,
    /// `φ θ ψ` \[rad\].
    pub angles: Vector3<f64>,
}

/// Orientation of a hand that looks straight down: x forward, y right, z down.
fn robot_from_hand_looking_down() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
}

impl HandPose {
    /// The pose as a transform.
    pub fn robot_from_hand(&self) -> Isometry3<f64> {
        let turned = UnitQuaternion::from_euler_angles(self.angles.x, self.angles.y, self.angles.z);
        Isometry3::from_parts(Translation3::from(self.position), turned * robot_from_hand_looking_down())
    }

    /// The six numbers of a transform; `θ` in `[-π/2, π/2]`.
    pub fn from_transform(robot_from_hand: &Isometry3<f64>) -> Self {
        let turned = robot_from_hand.rotation * robot_from_hand_looking_down().inverse();
        let (phi, theta, psi) = turned.euler_angles();
        Self { position: robot_from_hand.translation.vector, angles: Vector3::new(phi, theta, psi) }
    }
}

/// A change of hand pose, `v = (x y z φ θ ψ)`: metres and radians. What its numbers mean is said by a [`LabelForm`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseChange {
    /// `v_xyz` \[m\].
    pub translation: Vector3<f64>,
    /// `v_φθψ` \[rad\].
    pub rotation: Vector3<f64>,
}

impl PoseChange {
    /// No change.
    pub fn zero() -> Self {
        Self { translation: Vector3::zeros(), rotation: Vector3::zeros() }
    }

    /// From `(x y z φ θ ψ)`.
    pub fn from_array(v: [f64; 6]) -> Self {
        Self { translation: Vector3::new(v[0], v[1], v[2]), rotation: Vector3::new(v[3], v[4], v[5]) }
    }

    /// As `(x y z φ θ ψ)`.
    pub fn to_array(&self) -> [f64; 6] {
        let (t, r) = (self.translation, self.rotation);
        [t.x, t.y, t.z, r.x, r.y, r.z]
    }

    /// As a column, translation first.
    pub fn to_vector(&self) -> Vector6<f64> {
        Vector6::from(self.to_array())
    }

    /// Both parts multiplied by one factor.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self { translation: self.translation * factor, rotation: self.rotation * factor }
    }

    /// The same direction of motion, shortened so that neither part exceeds its cap \[m\], \[rad\].
    #[must_use]
    pub fn capped(&self, translation: f64, rotation: f64) -> Self {
        let shorten = |length: f64, cap: f64| if length > cap { cap / length } else { 1.0 };
        let factor =
            shorten(self.translation.norm(), translation).min(shorten(self.rotation.norm(), rotation));
        self.scaled(factor)
    }

    /// The rigid motion whose twist, held for unit time, is `self`: the exponential map of SE(3).
    pub fn exp(&self) -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_scaled_axis(self.rotation);
        let translation = left_jacobian(&self.rotation) * self.translation;
        Isometry3::from_parts(translation.into(), rotation)
    }

    /// The twist of a rigid motion: the inverse of [`PoseChange::exp`] for turns below π.
    pub fn log(motion: &Isometry3<f64>) -> Self {
        let rotation = motion.rotation.scaled_axis();
        let translation = left_jacobian_inverse(&rotation) * motion.translation.vector;
        Self { translation, rotation }
    }
}

/// Left Jacobian of SO(3), `I + (1 - cos a)/a² [w] + (a - sin a)/a³ [w]²` with `a = ‖w‖`.
fn left_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let a = w.norm();
    let cross = w.cross_matrix();
    let (first, second) = if a < 1e-4 {
        (0.5 - a * a / 24.0, 1.0 / 6.0 - a * a / 120.0)
    } else {
        let (sin, cos) = libm::sincos(a);
        ((1.0 - cos) / (a * a), (a - sin) / (a * a * a))
    };
    Matrix3::identity() + cross * first + cross * cross * second
}

/// Inverse of [`left_jacobian`] in closed form.
fn left_jacobian_inverse(w: &Vector3<f64>) -> Matrix3<f64> {
    let a = w.norm();
    let cross = w.cross_matrix();
    let second = if a < 1e-4 {
        1.0 / 12.0 + a * a / 720.0
    } else {
        let (sin, cos) = libm::sincos(0.5 * a);
        (1.0 - a * cos / (2.0 * sin)) / (a * a)
    };
    Matrix3::identity() - cross * 0.5 + cross * cross * second
}

/// What the six numbers of a label mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LabelForm {
    /// `log(T_current⁻¹ T_goal)` in se(3), in the current hand frame. The two images alone decide it, and swapping them
    /// negates it.
    Twist,
    /// The paper's `Δx` (Section 4.1): goal minus current as [`HandPose`] numbers, in the robot frame.
    Difference,
}

impl LabelForm {
    /// The label of a pair of hand poses.
    pub fn label(self, robot_from_current: &Isometry3<f64>, robot_from_goal: &Isometry3<f64>) -> PoseChange {
        match self {
            Self::Twist => PoseChange::log(&robot_from_current.inv_mul(robot_from_goal)),
            Self::Difference => {
                let current = HandPose::from_transform(robot_from_current);
                let goal = HandPose::from_transform(robot_from_goal);
                PoseChange {
                    translation: goal.position - current.position,
                    rotation: (goal.angles - current.angles).map(wrapped),
                }
            }
        }
    }

    /// The twist in the current hand frame that a label asks for; the inverse of [`LabelForm::label`] in its goal.
    pub fn twist(self, label: &PoseChange, robot_from_current: &Isometry3<f64>) -> PoseChange {
        match self {
            Self::Twist => *label,
            Self::Difference => {
                let current = HandPose::from_transform(robot_from_current);
                let goal = HandPose {
                    position: current.position + label.translation,
                    angles: current.angles + label.rotation,
                };
                PoseChange::log(&robot_from_current.inv_mul(&goal.robot_from_hand()))
            }
        }
    }
}

/// The equal angle in `[-π, π]`.
fn wrapped(angle: f64) -> f64 {
    angle - (angle / std::f64::consts::TAU).round() * std::f64::consts::TAU
}

/// Adjoint of `a_from_b`: takes a twist (translation first) expressed in `b` to the same motion's twist in `a`.
pub fn adjoint(a_from_b: &Isometry3<f64>) -> Matrix6<f64> {
    let rotation = a_from_b.rotation.to_rotation_matrix();
    let mut result = Matrix6::zeros();
    result.fixed_view_mut::<3, 3>(0, 0).copy_from(rotation.matrix());
    result.fixed_view_mut::<3, 3>(3, 3).copy_from(rotation.matrix());
    let cross = a_from_b.translation.vector.cross_matrix() * rotation.matrix();
    result.fixed_view_mut::<3, 3>(0, 3).copy_from(&cross);
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    fn poses() -> impl Strategy<Value = HandPose> {
        (prop::array::uniform3(-0.5..0.5f64), prop::array::uniform3(-1.2..1.2f64))
            .prop_map(|(p, a)| HandPose { position: p.into(), angles: a.into() })
    }

    /// The exponential by its power series, as a 4 x 4 matrix.
    fn series_exp(v: &PoseChange) -> nalgebra::Matrix4<f64> {
        let mut twist = nalgebra::Matrix4::zeros();
        twist.fixed_view_mut::<3, 3>(0, 0).copy_from(&v.rotation.cross_matrix());
        twist.fixed_view_mut::<3, 1>(0, 3).copy_from(&v.translation);
        let mut term = nalgebra::Matrix4::identity();
        (1..40).fold(nalgebra::Matrix4::identity(), |sum, n| {
            term = term * twist / f64::from(n);
            sum + term
        })
    }

    proptest! {
        #[test]
        fn exp_is_the_power_series(v in prop::array::uniform6(-1.0..1.0f64)) {
            let v = PoseChange::from_array(v);
            assert_relative_eq!(v.exp().to_homogeneous(), series_exp(&v), epsilon = 1e-12);
        }

        #[test]
        fn log_inverts_exp_also_for_tiny_turns(v in prop::array::uniform6(-1.0..1.0f64), exponent in 0..8i32) {
            let v = PoseChange::from_array(v).scaled(10f64.powi(-exponent));
            assert_relative_eq!(PoseChange::log(&v.exp()).to_vector(), v.to_vector(), epsilon = 1e-11);
        }

        #[test]
        fn six_numbers_and_transform_are_one_pose(pose in poses()) {
            let again = HandPose::from_transform(&pose.robot_from_hand());
            assert_relative_eq!(again.position, pose.position, epsilon = 1e-12);
            assert_relative_eq!(again.angles, pose.angles, epsilon = 1e-9);
        }

        #[test]
        fn a_label_leads_from_current_to_goal(current in poses(), goal in poses()) {
            let (current, goal) = (current.robot_from_hand(), goal.robot_from_hand());
            for form in [LabelForm::Twist, LabelForm::Difference] {
                let twist = form.twist(&form.label(&current, &goal), &current);
                assert_relative_eq!(current * twist.exp(), goal, epsilon = 1e-9);
            }
        }

        #[test]
        fn swapping_the_poses_negates_the_twist(current in poses(), goal in poses()) {
            let (current, goal) = (current.robot_from_hand(), goal.robot_from_hand());
            let there = LabelForm::Twist.label(&current, &goal);
            let back = LabelForm::Twist.label(&goal, &current);
            assert_relative_eq!(there.to_vector(), -back.to_vector(), epsilon = 1e-9);
        }

        #[test]
        fn adjoint_is_conjugation(pose in poses(), v in prop::array::uniform6(-0.5..0.5f64)) {
            let a_from_b = pose.robot_from_hand();
            let in_b = PoseChange::from_array(v);
            let in_a = PoseChange::from_array((adjoint(&a_from_b) * in_b.to_vector()).into());
            assert_relative_eq!(in_a.exp(), a_from_b * in_b.exp() * a_from_b.inverse(), epsilon = 1e-12);
        }
    }

    #[test]
    fn a_hand_without_angles_looks_down_with_x_forward() {
        let pose = HandPose { position: Vector3::zeros(), angles: Vector3::zeros() }.robot_from_hand();
        assert_relative_eq!(pose * Vector3::x(), Vector3::x(), epsilon = 1e-15);
        assert_relative_eq!(pose * Vector3::y(), -Vector3::y(), epsilon = 1e-15);
        assert_relative_eq!(pose * Vector3::z(), -Vector3::z(), epsilon = 1e-15);
    }

    #[test]
    fn a_cap_keeps_the_direction() {
        let v = PoseChange::from_array([0.03, 0.04, 0.0, 0.0, 0.0, 0.1]).capped(0.01, 1.0);
        assert_relative_eq!(v.to_vector(), Vector6::new(0.006, 0.008, 0.0, 0.0, 0.0, 0.02), epsilon = 1e-15);
    }
}
