//! The ways in which a session can end.

use serde::{Deserialize, Serialize};

/// How a session ended. This is a value, not an error: failed sessions are results, too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The loop settled, not necessarily at the goal: see the final error.
    Converged,
    /// The hand hit an obstacle or the table, and stopped there.
    Collided,
    /// The target's center left the image and did not return.
    TargetLost,
    /// The quadratic program had no solution.
    Infeasible,
    /// The loop had not settled when the step limit was reached.
    IterationLimit,
}

impl Outcome {
    /// All outcomes, in the order of their discriminants.
    pub const ALL: [Self; 5] =
        [Self::Converged, Self::Collided, Self::TargetLost, Self::Infeasible, Self::IterationLimit];

    /// Returns the name used in result files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::Collided => "collided",
            Self::TargetLost => "target_lost",
            Self::Infeasible => "infeasible",
            Self::IterationLimit => "iteration_limit",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_in_session_records() {
        for (i, outcome) in Outcome::ALL.into_iter().enumerate() {
            assert_eq!(serde_json::to_value(outcome).unwrap(), outcome.name());
            assert_eq!(outcome as usize, i);
        }
    }
}
