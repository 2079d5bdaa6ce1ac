//! The stop rule. The paper stops when the images are "sufficiently similar" (Section 3.1) without saying how similar. Here,
//! as in CNS (Chen et al., 2023), a session stops when the desired motion is negligible or no longer shrinks.

use crate::config::StopConfig;
use world::PoseChange;

/// A desired motion counts as an improvement if it is smaller than this factor times the smallest so far.
const IMPROVEMENT: f64 = 0.9;

/// Watches the desired motions of a session.
#[derive(Debug, Clone)]
pub struct StopRule {
    config: StopConfig,
    settled: usize,
    best: f64,
    stale: usize,
}

impl StopRule {
    /// Creates the rule for a new session.
    pub fn new(config: &StopConfig) -> Self {
        Self { config: config.clone(), settled: 0, best: f64::INFINITY, stale: 0 }
    }

    /// Takes in the desired motion of a step and returns whether the loop has settled. `free` says that the motion was not
    /// deflected. A deflected motion need not shrink from step to step, so only free ones count toward the patience.
    pub fn settles(&mut self, desired: &PoseChange, free: bool) -> bool {
        self.settled = if below(desired, self.config.settled()) { self.settled + 1 } else { 0 };
        let near = self.config.near();
        // Both parts relative to their bounds.
        let size = (desired.translation.norm() / near.0).hypot(desired.rotation.norm() / near.1);
        if size < IMPROVEMENT * self.best {
            (self.best, self.stale) = (size, 0);
        } else if free {
            self.stale += 1;
        }
        let stuck = self.stale >= self.config.patience_steps && below(desired, near);
        self.settled >= self.config.settled_steps || stuck
    }
}

/// Returns whether both parts of a motion are below their bounds \[m\], \[rad\].
fn below(motion: &PoseChange, (translation, rotation): (f64, f64)) -> bool {
    motion.translation.norm() < translation && motion.rotation.norm() < rotation
}

#[cfg(test)]
mod tests {
    use super::*;
    use world::units::{deg, mm};

    fn rule() -> StopRule {
        StopRule::new(&StopConfig {
            settled_mm: 0.02,
            settled_deg: 0.02,
            settled_steps: 3,
            near_mm: 5.0,
            near_deg: 3.0,
            patience_steps: 4,
        })
    }

    fn along_x(length_mm: f64) -> PoseChange {
        PoseChange::from_array([mm(length_mm), 0.0, 0.0, 0.0, 0.0, 0.0])
    }

    /// Returns the step at which the rule stops a series of desired translations.
    fn stops_at(lengths_mm: &[f64], free: bool) -> Option<usize> {
        let mut rule = rule();
        lengths_mm.iter().position(|&length| rule.settles(&along_x(length), free))
    }

    #[test]
    fn three_vanishing_motions_in_a_row_settle() {
        assert_eq!(stops_at(&[10.0, 0.01, 0.008, 1.0, 0.006, 0.005, 0.004, 0.003], true), Some(6));
    }

    #[test]
    fn a_remaining_rotation_keeps_the_loop_going() {
        let mut rule = rule();
        let turn = PoseChange::from_array([0.0, 0.0, 0.0, 0.0, 0.0, deg(1.0)]);
        assert!((0..4).all(|_| !rule.settles(&turn, true)));
    }

    #[test]
    fn near_the_goal_patience_ends() {
        assert_eq!(stops_at(&[10.0, 3.0, 2.8, 2.9, 2.8, 2.75], true), Some(5));
        assert_eq!(stops_at(&[10.0, 3.0, 2.8, 2.6, 2.4, 2.2], true), None, "improves by 10 % often enough");
    }

    #[test]
    fn far_from_the_goal_or_while_deflected_it_does_not() {
        assert_eq!(stops_at(&[8.0; 50], true), None);
        assert_eq!(stops_at(&[3.0; 50], false), None);
    }
}
