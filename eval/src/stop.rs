//! When a session has settled. The paper stops when the images are "sufficiently similar" (Section 3.1) and says no more;
//! here, as in CNS (Chen et al., 2023), when the desired motion has vanished or has stopped shrinking.

use crate::config::StopConfig;
use world::PoseChange;

/// What counts as an improvement: a desired motion smaller by this factor than all before.
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
    /// Before the first step.
    pub fn new(config: &StopConfig) -> Self {
        Self { config: config.clone(), settled: 0, best: f64::INFINITY, stale: 0 }
    }

    /// Has the loop settled? `free`: nothing but the desired motion decided where the hand went.
    ///
    /// A motion that is deflected need not shrink from step to step, so that only free ones try the patience.
    pub fn settles(&mut self, desired: &PoseChange, free: bool) -> bool {
        self.settled = if below(desired, self.config.settled()) { self.settled + 1 } else { 0 };
        let near = self.config.near();
        // Both parts in units of what counts as near.
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

/// Are both parts of a motion below their bounds \[m\], \[rad\]?
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

    /// The step at which the rule stops a series of desired translations.
    fn stops_at(lengths_mm: &[f64], free: bool) -> Option<usize> {
        let mut rule = rule();
        lengths_mm.iter().position(|&length| rule.settles(&along_x(length), free))
    }

    #[test]
    fn three_vanishing_motions_in_a_row_settle() {
        assert_eq!(stops_at(&[10.0, 0.01, 0.008, 1.0, 0.006, 0.005, 0.004, 0.003], true), Some(6));
    }

    #[test]
    fn a_turn_that_is_left_keeps_the_loop_going() {
        let mut rule = rule();
        let turn = PoseChange::from_array([0.0, 0.0, 0.0, 0.0, 0.0, deg(1.0)]);
        assert!((0..4).all(|_| !rule.settles(&turn, true)));
    }

    #[test]
    fn near_the_goal_patience_ends() {
        assert_eq!(stops_at(&[10.0, 3.0, 2.8, 2.9, 2.8, 2.75], true), Some(5));
        assert_eq!(
            stops_at(&[10.0, 3.0, 2.8, 2.6, 2.4, 2.2], true),
            None,
            "10 % below the best, now and then"
        );
    }

    #[test]
    fn far_from_the_goal_or_while_deflected_it_does_not() {
        assert_eq!(stops_at(&[8.0; 50], true), None);
        assert_eq!(stops_at(&[3.0; 50], false), None);
    }
}
