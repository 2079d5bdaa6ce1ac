//! An evaluation: all servo sessions of a configuration.

use crate::config::EvalConfig;
use crate::error::{Error, Result};
use crate::policy::Policies;
use crate::session::Session;
use crate::session::record::SessionRecord;
use crate::trial::Trial;
use rayon::prelude::{IntoParallelIterator, ParallelIterator};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use world::Environment;

/// Runs all sessions of a configuration in parallel and returns their records in order of index. Except for times, the
/// records do not depend on the number of threads.
///
/// `progress` is called after every session. Setting `stop` ends the run with [`Error::Interrupted`] after the running
/// sessions have finished.
pub fn run_sessions(
    environment: &Environment,
    config: &EvalConfig,
    policies: Policies,
    progress: &(dyn Fn(&SessionRecord) + Sync),
    stop: &AtomicBool,
) -> Result<Vec<SessionRecord>> {
    let done = AtomicUsize::new(0);
    let session = |index| {
        if stop.load(Ordering::Relaxed) {
            return Err(Error::Interrupted { done: done.load(Ordering::Relaxed), total: config.sessions });
        }
        let trial = Trial::draw(environment, config, index)?;
        let record = Session::new(environment, config, policies, &trial).run()?;
        done.fetch_add(1, Ordering::Relaxed);
        progress(&record);
        Ok(record)
    };
    (0..config.sessions).into_par_iter().map(session).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::eval_config;
    use crate::policy::oracle::Oracle;
    use crate::session::deflect::DeflectionKind;
    use crate::session::outcome::Outcome;
    use crate::session::timing::StageSeconds;
    use rayon::ThreadPoolBuilder;

    /// Runs all sessions with oracles.
    fn run(config: &EvalConfig, stop: bool) -> Result<Vec<SessionRecord>> {
        let environment = Environment::new(&config.world).unwrap();
        let policies = Policies { approach: &Oracle, avoid: &Oracle };
        run_sessions(&environment, config, policies, &|_| (), &AtomicBool::new(stop))
    }

    #[test]
    fn with_oracles_every_session_reaches_its_goal_without_a_collision() {
        let records = run(&eval_config(40), false).unwrap();
        for record in &records {
            assert_eq!(record.outcome, Outcome::Converged, "session {}", record.index);
            assert!(record.position_error < 1e-4, "session {}: {} m", record.index, record.position_error);
            assert!(
                record.orientation_error < 1e-3,
                "session {}: {} rad",
                record.index,
                record.orientation_error
            );
            assert_eq!((record.contacts.obstacle, record.contacts.table, record.limit_violations), (0, 0, 0));
        }
        assert!(records.iter().enumerate().all(|(i, record)| record.index == i), "in order");
        let turned =
            |record: &&SessionRecord| record.steps.iter().any(|step| step.deflection != DeflectionKind::Kept);
        assert!(records.iter().filter(turned).count() > 10, "obstacles are in the way");
    }

    #[test]
    fn records_do_not_depend_on_the_number_of_threads() {
        let config = eval_config(4);
        let run = |threads| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut records = pool.install(|| run(&config, false)).unwrap();
            for record in &mut records {
                record.seconds = StageSeconds::default();
                record.steps.iter_mut().for_each(|step| step.seconds = StageSeconds::default());
            }
            records
        };
        assert_eq!(run(1), run(3));
    }

    #[test]
    fn a_run_can_be_stopped() {
        let stopped = run(&eval_config(2), true);
        assert!(matches!(stopped, Err(Error::Interrupted { done: 0, total: 2 })));
    }
}
