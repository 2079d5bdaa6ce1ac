//! Outcomes of a system's sessions, and the cost of a step.

use super::distribution::Distribution;
use crate::session::outcome::Outcome;
use crate::session::record::SessionRecord;
use crate::session::timing::StageSeconds;

/// Counts of sessions by outcome and incident, with iterations and times.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outcomes {
    /// All sessions.
    pub sessions: usize,
    /// Sessions by outcome, in the order of [`Outcome::ALL`].
    ended: [usize; Outcome::ALL.len()],
    /// Sessions with the target's center outside the image at some step.
    pub target_out_of_view: usize,
    /// Sessions in which the hand touched the target.
    pub touched_target: usize,
    /// Sessions with a joint outside its limits at some step.
    pub limit_violation: usize,
    /// Steps per session.
    pub iterations: Distribution,
    /// Mean time per step by stage, in the order of [`StageSeconds::NAMES`] \[s\].
    pub seconds_per_step: [f64; StageSeconds::NAMES.len()],
}

impl Outcomes {
    /// Summarizes all sessions of a system.
    pub fn of(records: &[SessionRecord]) -> Self {
        let count =
            |holds: &dyn Fn(&SessionRecord) -> bool| records.iter().filter(|record| holds(record)).count();
        let iterations: Vec<f64> = records.iter().map(|record| record.steps.len() as f64).collect();
        let mut seconds = StageSeconds::default();
        for record in records {
            seconds += record.seconds;
        }
        let steps: f64 = iterations.iter().sum();
        Self {
            sessions: records.len(),
            ended: Outcome::ALL.map(|outcome| count(&|record| record.outcome == outcome)),
            target_out_of_view: count(&|record| record.target_lost_steps > 0),
            touched_target: count(&|record| record.contacts.target > 0),
            limit_violation: count(&|record| record.limit_violations > 0),
            iterations: Distribution::of(&iterations),
            seconds_per_step: seconds.to_array().map(|total| total / steps),
        }
    }

    /// Returns the number of sessions that ended this way.
    pub fn count(&self, outcome: Outcome) -> usize {
        self.ended[outcome as usize]
    }

    /// Returns all counts with their names.
    pub fn counts(&self) -> Vec<(&'static str, usize)> {
        let incidents = [
            ("target_out_of_view", self.target_out_of_view),
            ("touched_target", self.touched_target),
            ("limit_violation", self.limit_violation),
        ];
        Outcome::ALL.map(Outcome::name).into_iter().zip(self.ended).chain(incidents).collect()
    }

    /// Returns a count as a fraction of all sessions.
    pub fn share(&self, count: usize) -> f64 {
        count as f64 / self.sessions as f64
    }
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
        let outcomes = Outcomes::of(&records);
        let counts: Vec<usize> = outcomes.counts().into_iter().map(|(_, count)| count).collect();
        assert_eq!(counts, [2, 1, 1, 0, 0, 1, 1, 0]);
        assert_relative_eq!(outcomes.share(outcomes.count(Outcome::Converged)), 0.5);
        // Each step of the fixture spends 20 ms in the approach policy; the sessions differ in length.
        assert_relative_eq!(outcomes.seconds_per_step[1], 0.02, epsilon = 1e-12);
        let longest = records.iter().map(|r| r.steps.len()).max().unwrap();
        assert_relative_eq!(outcomes.iterations.maximum, longest as f64);
    }
}
