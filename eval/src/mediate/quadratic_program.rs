//! The quadratic program, solved with Clarabel.

use super::row::Row;
use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverStatus};
use nalgebra::{Matrix6, Vector6};
use serde::{Deserialize, Serialize};

/// Tolerances of the first attempt. With Clarabel's default of 1e-8 on the cost, a rotation can be off by 1e-3.
const TOLERANCE: f64 = 1e-11;

/// Tolerances of the second attempt, if rounding prevents the first: Clarabel's default.
const LOOSE_TOLERANCE: f64 = 1e-8;

/// Status of the quadratic program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum QpStatus {
    /// Solved to full accuracy.
    Solved,
    /// Solved to reduced accuracy.
    AlmostSolved,
    /// No displacement satisfies the hard rows.
    Infeasible,
    /// The solver failed, or the input was not finite.
    Failed,
}

impl QpStatus {
    /// Returns whether there is a displacement to execute.
    pub fn is_solved(self) -> bool {
        matches!(self, Self::Solved | Self::AlmostSolved)
    }
}

impl From<SolverStatus> for QpStatus {
    fn from(status: SolverStatus) -> Self {
        match status {
            SolverStatus::Solved => Self::Solved,
            SolverStatus::AlmostSolved => Self::AlmostSolved,
            SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => Self::Infeasible,
            _ => Self::Failed,
        }
    }
}

/// Eq. (4): `minimize ½ xᵀQx + cᵀx` subject to `Ax ≤ b`, where `x` is the displacement followed by the slacks of the soft rows.
pub(super) fn solve(
    q: &Matrix6<f64>,
    c: &Vector6<f64>,
    rows: &[Row],
    slack_weight: f64,
) -> (Vec<f64>, QpStatus) {
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
                (solver.solution.x, solver.solution.status.into())
            }
            Err(_) => (Vec::new(), QpStatus::Failed),
        }
    };
    let strict = attempt(TOLERANCE);
    if strict.1 == QpStatus::Failed { attempt(LOOSE_TOLERANCE) } else { strict }
}
