//! Mediation: the joint displacement that follows the deflected motion as closely as the arm and the camera allow (paper,
//! Section 5).
//!
//! ```text
//! minimize    ½ qᵀQq + cᵀq + w Σ s          Q = JᵀWJ + λI,  c = -JᵀWv̂
//! subject to  A q ≤ b                        joint positions and velocities
//!             A' q - s ≤ b',  s ≥ 0          field of view
//! ```
//!
//! `q` is the joint displacement of one step, `J` the hand's Jacobian in the hand frame, `v̂` the deflected motion, `W` makes
//! radians comparable with metres, `λ` keeps `Q` positive definite at a singular pose. The slack `s` costs `w` per unit of
//! normalized image coordinates: a linear price, so that a row that can be satisfied is satisfied exactly.

use crate::config::MediationConfig;
use crate::field_of_view::FieldOfView;
use crate::joint_limits::DisplacementBounds;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus};
use nalgebra::{Matrix6, Point3, RowVector6, Vector6};
use serde::{Deserialize, Serialize};
use world::arm::{Arm, JointVector};
use world::{Camera, PoseChange};

/// The problem is solved in units of the motion asked for, or of the largest violation of a row if that is larger, so that a
/// micrometre is followed as exactly as a centimetre. The unit is no smaller than this.
const LEAST_UNIT: f64 = 1e-6;

/// Clarabel's tolerances, in these units. Its default of 1e-8 on the cost is 1e-3 on a rotation.
const TOLERANCE: f64 = 1e-11;

/// The second attempt where rounding keeps the solver from the first tolerance: Clarabel's default.
const LOOSE_TOLERANCE: f64 = 1e-8;

/// No displacement is this long in these units: a row that leaves more room binds nothing, and large numbers cost accuracy.
const FAR: f64 = 1e3;

/// One row of the constraints: `a q ≤ b`, or `a q - s ≤ b` with a slack `s ≥ 0` of its own.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Row {
    a: RowVector6<f64>,
    b: f64,
    soft: bool,
}

impl Row {
    /// A row that always holds.
    pub(crate) fn hard(a: RowVector6<f64>, b: f64) -> Self {
        Self { a, b, soft: false }
    }

    /// A row that yields, at a price, where it cannot hold.
    pub(crate) fn soft(a: RowVector6<f64>, b: f64) -> Self {
        Self { a, b, soft: true }
    }

    /// `a q - b`: above 0 where the row is violated.
    #[cfg(test)]
    pub(crate) fn excess(&self, q: &Vector6<f64>) -> f64 {
        (self.a * q)[0] - self.b
    }
}

/// How the quadratic program ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum QpStatus {
    /// Solved to full accuracy.
    Solved,
    /// Solved, to less accuracy than asked for.
    AlmostSolved,
    /// No displacement satisfies the hard rows.
    Infeasible,
    /// The solver gave up, or the motion asked for was not finite.
    Failed,
}

impl QpStatus {
    /// Is there a displacement to execute?
    pub fn is_solved(self) -> bool {
        matches!(self, Self::Solved | Self::AlmostSolved)
    }
}

/// What the arm is told to do in one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Command {
    /// Joint displacement `q` \[rad\]; zero unless `status` is solved.
    pub displacement: JointVector,
    /// Largest slack of the field-of-view rows, in normalized image coordinates: 0 while they hold.
    pub slack: f64,
    /// How the program ended.
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
    /// For the camera on the hand.
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

    /// Length of a motion in the metric `W` \[m\].
    pub fn length(&self, v: &PoseChange) -> f64 {
        let v = v.to_vector();
        v.dot(&(self.weight * v)).sqrt()
    }

    /// The displacement from `joints` that follows `deflected` while the target stays in sight.
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

    /// Eq. (5), `minimize ‖v̂ - v‖²` in the metric `W`, for `v = Jq`; the paper prints `|v̂ - v|²`, metres and radians alike.
    fn minimize(&self, jacobian: &Matrix6<f64>, deflected: &PoseChange, rows: &[Row]) -> Command {
        let violation = rows.iter().map(|row| -row.b).fold(LEAST_UNIT, f64::max);
        let unit = self.length(deflected).max(violation);
        let v = deflected.to_vector() / unit;
        // Eq. (6), expanded. The paper prints Q = JᵀJ, only semidefinite, and c = Jᵀv̂, which moves away from the goal.
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

/// Eq. (4): `minimize ½ xᵀQx + cᵀx` subject to `Ax ≤ b`, where `x` is the displacement followed by the slacks of the soft rows.
fn solve(q: &Matrix6<f64>, c: &Vector6<f64>, rows: &[Row], slack_weight: f64) -> (Vec<f64>, QpStatus) {
    if !c.iter().chain(q.iter()).all(|x| x.is_finite()) {
        return (Vec::new(), QpStatus::Failed);
    }
    let soft: Vec<usize> = (0..rows.len()).filter(|&i| rows[i].soft).collect();
    let unknowns = 6 + soft.len();

    let mut quadratic = vec![vec![0.0; unknowns]; unknowns];
    for (i, j) in (0..6).flat_map(|i| (i..6).map(move |j| (i, j))) {
        quadratic[i][j] = q[(i, j)];
    }
    let mut linear = vec![slack_weight; unknowns];
    linear[..6].copy_from_slice(c.as_slice());

    let mut a: Vec<Vec<f64>> = rows.iter().map(|row| row.a.iter().copied().collect()).collect();
    for row in &mut a {
        row.resize(unknowns, 0.0);
    }
    let mut b: Vec<f64> = rows.iter().map(|row| row.b).collect();
    for (slack, &row) in soft.iter().enumerate() {
        a[row][6 + slack] = -1.0;
        let mut not_negative = vec![0.0; unknowns];
        not_negative[6 + slack] = -1.0;
        a.push(not_negative);
        b.push(0.0);
    }

    let (quadratic, a) = (CscMatrix::from(&quadratic), CscMatrix::from(&a));
    let attempt = |tolerance| {
        let settings = DefaultSettings {
            verbose: false,
            tol_gap_abs: tolerance,
            tol_gap_rel: tolerance,
            tol_feas: tolerance,
            ..DefaultSettings::default()
        };
        match DefaultSolver::new(&quadratic, &linear, &a, &b, &[NonnegativeConeT(b.len())], settings) {
            Ok(mut solver) => {
                solver.solve();
                (solver.solution.x, status(solver.solution.status))
            }
            Err(_) => (Vec::new(), QpStatus::Failed),
        }
    };
    let strict = attempt(TOLERANCE);
    if strict.1 == QpStatus::Failed { attempt(LOOSE_TOLERANCE) } else { strict }
}

/// Clarabel's verdict in ours.
fn status(status: SolverStatus) -> QpStatus {
    match status {
        SolverStatus::Solved => QpStatus::Solved,
        SolverStatus::AlmostSolved => QpStatus::AlmostSolved,
        SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => QpStatus::Infeasible,
        _ => QpStatus::Failed,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;
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

    /// Jacobians of an arm's size, none of them singular.
    fn jacobians() -> impl Strategy<Value = Matrix6<f64>> {
        prop::collection::vec(-0.3..0.3f64, 36).prop_map(|m| Matrix6::from_vec(m) + Matrix6::identity())
    }

    /// Numbers of which not all are small.
    fn six() -> impl Strategy<Value = [f64; 6]> {
        prop::array::uniform6(-1.0..1.0f64).prop_map(|[first, rest @ ..]| {
            let [a, b, c, d, e] = rest;
            [first + 2.0, a, b, c, d, e]
        })
    }

    /// From 0.01 mm to 100 mm.
    fn motions() -> impl Strategy<Value = PoseChange> {
        (six(), -5..-1i32).prop_map(|(v, exponent)| PoseChange::from_array(v).scaled(10f64.powi(exponent)))
    }

    /// `Q` and `c` written out from the cost `½ (Jq - v)ᵀW(Jq - v) + ½ λ qᵀq`.
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
                prop_assert!(*slope > -tolerance || at_upper, "falls towards {x}, which is not the upper bound");
                prop_assert!(*slope < tolerance || at_lower, "falls towards {x}, which is not the lower bound");
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
