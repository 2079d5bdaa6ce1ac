//! Mediation: finds the joint displacement that follows the deflected motion as closely as the arm and the camera allow
//! (paper, Section 5).
//!
//! ```text
//! minimize    ½ qᵀQq + cᵀq + w Σ s          Q = JᵀWJ + λI,  c = -JᵀWv̂
//! subject to  A q ≤ b                        joint positions and velocities
//!             A' q - s ≤ b',  s ≥ 0          field of view
//! ```
//!
//! Here `q` is the joint displacement of one step, `J` the Jacobian in the hand frame, and `v̂` the deflected motion. `W` makes
//! radians comparable with meters, and `λ` keeps `Q` positive definite at a singular pose. The slack `s` costs `w` per unit
//! of normalized image coordinates. This cost is linear, so that a row that can be satisfied is satisfied exactly.

pub mod field_of_view;
pub mod joint_limits;
pub mod quadratic_program;
mod row;

use crate::config::MediationConfig;
use field_of_view::FieldOfView;
use joint_limits::DisplacementBounds;
use nalgebra::{Matrix6, Point3, Vector6};
use quadratic_program::{QpStatus, solve};
use row::Row;
use world::arm::{Arm, JointVector};
use world::{Camera, PoseChange};

/// Lower bound of the unit in which the program is solved. The unit is the length of the motion or the largest violation of a
/// row, whichever is larger, so that a micrometer is followed as exactly as a centimeter.
const LEAST_UNIT: f64 = 1e-6;

/// Upper bound of `b` in these units. No displacement is that long, so a larger `b` has no effect but costs accuracy.
const FAR: f64 = 1e3;

/// The command to the arm in one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// Joint displacement `q` \[rad\]; zero unless the program was solved.
    pub displacement: JointVector,
    /// Largest slack of the field-of-view rows, in normalized image coordinates; 0 if they hold.
    pub slack: f64,
    /// Status of the program.
    pub status: QpStatus,
}

/// Turns hand motions into joint displacements.
#[derive(Debug, Clone)]
pub struct Mediator {
    weight: Matrix6<f64>,
    damping: f64,
    slack_weight: f64,
    period: f64,
    field_of_view: FieldOfView,
}

impl Mediator {
    /// Creates a mediator for a camera on the hand.
    pub fn new(config: &MediationConfig, camera: &Camera) -> Self {
        let rotation = config.rotation_weight().powi(2);
        Self {
            weight: Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, rotation, rotation, rotation)),
            damping: config.damping,
            slack_weight: config.slack_weight,
            period: config.period_s,
            field_of_view: FieldOfView::new(camera, config.image_margin),
        }
    }

    /// Returns the length of a motion in the metric `W` \[m\].
    pub fn length(&self, v: &PoseChange) -> f64 {
        let v = v.to_vector();
        v.dot(&(self.weight * v)).sqrt()
    }

    /// Returns the displacement from `joints` that follows `deflected` and keeps the point `target` in view.
    pub fn solve(
        &self,
        arm: &Arm,
        joints: &JointVector,
        deflected: &PoseChange,
        target: &Point3<f64>,
    ) -> Command {
        let jacobian = arm.jacobian(joints);
        let bounds = DisplacementBounds::new(arm.limits(), joints, self.period);
        let mut rows: Vec<Row> = bounds.rows().collect();
        rows.extend(self.field_of_view.rows(&arm.robot_from_hand(joints), &jacobian, target));
        let command = self.minimize(&jacobian, deflected, &rows);
        Command { displacement: bounds.clamp(&command.displacement), ..command }
    }

    /// Eq. (5), `minimize ‖v̂ - v‖²` in the metric `W`, for `v = Jq`; the paper prints `|v̂ - v|²` without weights.
    fn minimize(&self, jacobian: &Matrix6<f64>, deflected: &PoseChange, rows: &[Row]) -> Command {
        let violation = rows.iter().map(|row| -row.b).fold(LEAST_UNIT, f64::max);
        let unit = self.length(deflected).max(violation);
        let v = deflected.to_vector() / unit;
        // Eq. (6), expanded. The paper prints Q = JᵀJ, which is only semidefinite, and c = Jᵀv̂, which moves away from the goal.
        let q = jacobian.tr_mul(&(self.weight * jacobian)) + Matrix6::identity() * self.damping;
        let c = -jacobian.tr_mul(&(self.weight * v));
        let scaled: Vec<Row> =
            rows.iter().map(|row| Row { b: (row.b / unit).min(FAR), ..row.clone() }).collect();
        let (solution, status) = solve(&q, &c, &scaled, self.slack_weight / unit);
        if !status.is_solved() {
            return Command { displacement: JointVector::zeros(), slack: 0.0, status };
        }
        let displacement = JointVector::from_column_slice(&solution[..6]) * unit;
        let slack = solution[6..].iter().fold(0.0, |largest: f64, s| largest.max(*s)) * unit;
        Command { displacement, slack, status }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
    use nalgebra::RowVector6;
    use proptest::prelude::*;
    use world::config::CameraConfig;

    fn mediator() -> Mediator {
        let camera =
            CameraConfig { width: 640, height: 480, horizontal_fov_deg: 60.0, behind_hand_mm: 100.0 };
        let config = MediationConfig {
            rotation_weight_mm: 100.0,
            damping: 1e-6,
            period_s: 0.2,
            image_margin: 0.05,
            slack_weight: 1.0,
        };
        Mediator::new(&config, &Camera::new(&camera))
    }

    fn bounds(reach: f64) -> DisplacementBounds {
        DisplacementBounds { lower: JointVector::repeat(-reach), upper: JointVector::repeat(reach) }
    }

    fn rows(reach: f64) -> Vec<Row> {
        bounds(reach).rows().collect()
    }

    /// Nonsingular Jacobians with entries like an arm's.
    fn jacobians() -> impl Strategy<Value = Matrix6<f64>> {
        prop::collection::vec(-0.3..0.3f64, 36).prop_map(|m| Matrix6::from_vec(m) + Matrix6::identity())
    }

    /// Six numbers, not all of them small.
    fn six() -> impl Strategy<Value = [f64; 6]> {
        prop::array::uniform6(-1.0..1.0f64).prop_map(|[first, rest @ ..]| {
            let [a, b, c, d, e] = rest;
            [first + 2.0, a, b, c, d, e]
        })
    }

    /// Motions of 0.01 mm to 100 mm.
    fn motions() -> impl Strategy<Value = PoseChange> {
        (six(), -5..-1i32).prop_map(|(v, exponent)| PoseChange::from_array(v).scaled(10f64.powi(exponent)))
    }

    /// `Q` and `c` expanded from the cost `½ (Jq - v)ᵀW(Jq - v) + ½ λ qᵀq`.
    fn cost(mediator: &Mediator, jacobian: &Matrix6<f64>, v: &PoseChange) -> (Matrix6<f64>, Vector6<f64>) {
        let weighted = jacobian.transpose() * mediator.weight;
        (weighted * jacobian + Matrix6::identity() * mediator.damping, -weighted * v.to_vector())
    }

    proptest! {
        #[test]
        fn without_active_rows_it_is_weighted_least_squares(jacobian in jacobians(), v in motions()) {
            let (q, c) = cost(&mediator(), &jacobian, &v);
            let expected = q.lu().solve(&-c).unwrap();
            let command = mediator().minimize(&jacobian, &v, &rows(10.0));
            prop_assert!(command.status.is_solved());
            assert_relative_eq!(command.displacement, expected, epsilon = 1e-3 * v.to_vector().norm());
        }

        #[test]
        fn with_bounds_the_kkt_conditions_hold(jacobian in jacobians(), v in motions()) {
            let size = v.to_vector().norm();
            let reach = 0.3 * size;
            let command = mediator().minimize(&jacobian, &v, &rows(reach));
            prop_assert!(command.status.is_solved());
            let (q, c) = cost(&mediator(), &jacobian, &v);
            let gradient = q * command.displacement + c;
            let tolerance = 1e-4 * size;
            for (x, slope) in command.displacement.iter().zip(&gradient) {
                prop_assert!(x.abs() <= reach + tolerance);
                let at_upper = *x > reach - tolerance;
                let at_lower = *x < tolerance - reach;
                prop_assert!(*slope > -tolerance || at_upper, "falls toward {x}, which is not the upper bound");
                prop_assert!(*slope < tolerance || at_lower, "falls toward {x}, which is not the lower bound");
            }
        }

        #[test]
        fn one_active_row_is_the_projection_onto_it(jacobian in jacobians(), v in motions(), a in six()) {
            let (q, c) = cost(&mediator(), &jacobian, &v);
            let inverse = q.try_inverse().unwrap();
            let a = RowVector6::from_row_slice(&a);
            let free = -inverse * c;
            let b = (a * free)[0] - 0.1 * v.to_vector().norm();
            let expected = free - inverse * a.transpose() * ((a * free)[0] - b) / (a * inverse * a.transpose())[0];
            for row in [Row::hard(a, b), Row::soft(a, b)] {
                let command = mediator().minimize(&jacobian, &v, &[rows(10.0), vec![row]].concat());
                prop_assert!(command.status.is_solved());
                assert_relative_eq!(command.displacement, expected, epsilon = 1e-3 * v.to_vector().norm());
                prop_assert!(command.slack < 1e-3 * v.to_vector().norm());
            }
        }
    }

    #[test]
    fn with_the_identity_as_jacobian_bounds_cut_off_each_joint_alone() {
        let v = PoseChange::from_array([0.02, -0.05, 0.01, 0.3, -0.04, 0.0]);
        let command = mediator().minimize(&Matrix6::identity(), &v, &rows(0.04));
        let expected = Vector6::new(0.02, -0.04, 0.01, 0.04, -0.04, 0.0);
        assert_relative_eq!(command.displacement, expected, epsilon = 1e-5);
    }

    #[test]
    fn a_soft_row_that_cannot_hold_yields_and_a_hard_one_does_not() {
        let forward = RowVector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let solve = |row| {
            mediator().minimize(&Matrix6::identity(), &PoseChange::zero(), &[rows(0.1), vec![row]].concat())
        };
        let soft = solve(Row::soft(forward, -0.3));
        assert_eq!(soft.status, QpStatus::Solved);
        assert_relative_eq!(soft.displacement, Vector6::new(-0.1, 0.0, 0.0, 0.0, 0.0, 0.0), epsilon = 1e-6);
        assert_relative_eq!(soft.slack, 0.2, epsilon = 1e-6);
        let hard = solve(Row::hard(forward, -0.3));
        assert_eq!((hard.status, hard.displacement), (QpStatus::Infeasible, Vector6::zeros()));
    }

    #[test]
    fn a_motion_that_is_not_finite_is_refused() {
        let v = PoseChange::from_array([f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let command = mediator().minimize(&Matrix6::identity(), &v, &rows(0.1));
        assert_eq!((command.status, command.displacement), (QpStatus::Failed, Vector6::zeros()));
    }
}
