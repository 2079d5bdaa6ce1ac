//! How servo sessions went, apart from their accuracy: outcomes, incidents, iterations and time.

use crate::accuracy::Distribution;
use crate::trace::{Outcome, SessionRecord, StageSeconds};

/// The stages of a step, in the order of Figure 2.
pub const STAGES: [&str; 5] = ["render", "approach", "avoid", "deflect", "qp"];

/// Numbers of sessions, and what a step costs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conduct {
    /// All sessions.
    pub sessions: usize,
    /// Those that settled.
    pub converged: usize,
    /// Those in which the hand ran into an obstacle or the table.
    pub collided: usize,
    /// Those that lost the target for good.
    pub target_lost: usize,
    /// Those whose quadratic program gave no displacement.
    pub infeasible: usize,
    /// Those that had not settled after the last step allowed.
    pub iteration_limit: usize,
    /// Those in which the target's center was outside the image at some step.
    pub target_out_of_view: usize,
    /// Those in which the hand touched the target.
    pub touched_target: usize,
    /// Those in which a joint was outside its limits at some step.
    pub limit_violation: usize,
    /// Steps of a session.
    pub iterations: Distribution,
    /// Mean time of each stage of a step, as in [`STAGES`] \[s\].
    pub seconds_per_step: [f64; 5],
}

impl Conduct {
    /// Of all sessions of a system.
    pub fn of(records: &[SessionRecord]) -> Self {
        let count =
            |holds: &dyn Fn(&SessionRecord) -> bool| records.iter().filter(|record| holds(record)).count();
        let ended = |outcome| count(&|record| record.outcome == outcome);
        let iterations: Vec<f64> = records.iter().map(|record| record.steps.len() as f64).collect();
        let mut seconds = StageSeconds::default();
        for record in records {
            seconds += record.seconds;
        }
        let steps: f64 = iterations.iter().sum();
        Self {
            sessions: records.len(),
            converged: ended(Outcome::Converged),
            collided: ended(Outcome::Collided),
            target_lost: ended(Outcome::TargetLost),
            infeasible: ended(Outcome::Infeasible),
            iteration_limit: ended(Outcome::IterationLimit),
            target_out_of_view: count(&|record| record.target_lost_steps > 0),
            touched_target: count(&|record| record.contacts.target > 0),
            limit_violation: count(&|record| record.limit_violations > 0),
            iterations: Distribution::of(&iterations),
            seconds_per_step: stages(&seconds).map(|total| total / steps),
        }
    }

    /// Every number of sessions with its name.
    pub fn counts(&self) -> [(&'static str, usize); 8] {
        [
            ("converged", self.converged),
            ("collided", self.collided),
            ("target_lost", self.target_lost),
            ("infeasible", self.infeasible),
            ("iteration_limit", self.iteration_limit),
            ("target_out_of_view", self.target_out_of_view),
            ("touched_target", self.touched_target),
            ("limit_violation", self.limit_violation),
        ]
    }

    /// A number of sessions as a share of all.
    pub fn share(&self, count: usize) -> f64 {
        count as f64 / self.sessions as f64
    }
}

/// The stages' times in the order of [`STAGES`].
fn stages(seconds: &StageSeconds) -> [f64; 5] {
    [seconds.render, seconds.approach, seconds.avoid, seconds.deflect, seconds.qp]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::session;
    use approx::assert_relative_eq;

    #[test]
    fn outcomes_are_counted_once_and_times_are_per_step() {
        let mut records: Vec<SessionRecord> = (0..4).map(session).collect();
        records[1].outcome = Outcome::Collided;
        records[2].outcome = Outcome::TargetLost;
        records[2].target_lost_steps = 3;
        records[3].contacts.target = 2;
        let conduct = Conduct::of(&records);
        assert_eq!(conduct.counts().map(|(_, count)| count), [2, 1, 1, 0, 0, 1, 1, 0]);
        assert_relative_eq!(conduct.share(conduct.converged), 0.5);
        // Every step of the fixture takes 20 ms in the approach policy, sessions are of different length.
        assert_relative_eq!(conduct.seconds_per_step[1], 0.02, epsilon = 1e-12);
        let longest = records.iter().map(|r| r.steps.len()).max().unwrap();
        assert_relative_eq!(conduct.iterations.maximum, longest as f64);
    }
}
