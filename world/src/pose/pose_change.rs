//! A change of hand pose, and the exponential map of SE(3).

use nalgebra::{Isometry3, Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// A change of hand pose, `v = (x y z φ θ ψ)`, in meters and radians. A [`LabelForm`](crate::LabelForm) defines the meaning of
/// the numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseChange {
    /// `v_xyz` \[m\].
    pub translation: Vector3<f64>,
    /// `v_φθψ` \[rad\].
    pub rotation: Vector3<f64>,
}

impl PoseChange {
    /// Returns the change that leaves a pose unchanged.
    pub fn zero() -> Self {
        Self { translation: Vector3::zeros(), rotation: Vector3::zeros() }
    }

    /// Creates a change from `(x y z φ θ ψ)`.
    pub fn from_array(v: [f64; 6]) -> Self {
        Self { translation: Vector3::new(v[0], v[1], v[2]), rotation: Vector3::new(v[3], v[4], v[5]) }
    }

    /// Returns `(x y z φ θ ψ)`.
    pub fn to_array(&self) -> [f64; 6] {
        let (t, r) = (self.translation, self.rotation);
        [t.x, t.y, t.z, r.x, r.y, r.z]
    }

    /// Returns a column vector, translation first.
    pub fn to_vector(&self) -> Vector6<f64> {
        Vector6::from(self.to_array())
    }

    /// Multiplies both parts by a factor.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self { translation: self.translation * factor, rotation: self.rotation * factor }
    }

    /// Shortens the motion, without changing its direction, so that neither part exceeds its cap (in \[m\] and \[rad\]).
    #[must_use]
    pub fn capped(&self, translation: f64, rotation: f64) -> Self {
        let shorten = |length: f64, cap: f64| if length > cap { cap / length } else { 1.0 };
        let factor =
            shorten(self.translation.norm(), translation).min(shorten(self.rotation.norm(), rotation));
        self.scaled(factor)
    }

    /// Returns the rigid motion that results from this twist, held for unit time: the exponential map of SE(3).
    pub fn exp(&self) -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_scaled_axis(self.rotation);
        let translation = left_jacobian(&self.rotation) * self.translation;
        Isometry3::from_parts(translation.into(), rotation)
    }

    /// Returns the twist of a rigid motion: the inverse of [`PoseChange::exp`] for rotations below π.
    pub fn log(motion: &Isometry3<f64>) -> Self {
        let rotation = motion.rotation.scaled_axis();
        let translation = left_jacobian_inverse(&rotation) * motion.translation.vector;
        Self { translation, rotation }
    }
}

/// Returns the left Jacobian of SO(3), `I + (1 - cos a)/a² [w] + (a - sin a)/a³ [w]²` with `a = ‖w‖`.
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

/// Returns the inverse of [`left_jacobian`] in closed form.
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

/// Returns the adjoint of `a_from_b`. It converts a twist (translation first) expressed in `b` to the twist of the same motion
/// in `a`.
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
    use crate::fixture::poses;
    use approx::assert_relative_eq;
    use proptest::prelude::*;

    /// Computes the exponential by its power series, as a 4 x 4 matrix.
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
        fn log_inverts_exp_also_for_tiny_rotations(v in prop::array::uniform6(-1.0..1.0f64), exponent in 0..8i32) {
            let v = PoseChange::from_array(v).scaled(10f64.powi(-exponent));
            assert_relative_eq!(PoseChange::log(&v.exp()).to_vector(), v.to_vector(), epsilon = 1e-11);
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
    fn a_cap_keeps_the_direction() {
        let v = PoseChange::from_array([0.03, 0.04, 0.0, 0.0, 0.0, 0.1]).capped(0.01, 1.0);
        assert_relative_eq!(v.to_vector(), Vector6::new(0.006, 0.008, 0.0, 0.0, 0.0, 0.02), epsilon = 1e-15);
    }
}
