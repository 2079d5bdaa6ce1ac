//! A servo session: the loop of the paper's Figure 2 on the arm, in the virtual environment.

use crate::config::{EvalConfig, ServoConfig};
use crate::deflect::{Course, Deflector};
use crate::error::{Error, Result};
use crate::mediate::Mediator;
use crate::policy::{Policies, Truth, View};
use crate::stop::StopRule;
use crate::trace::{ContactCounts, Outcome, SessionRecord, StageSeconds, Step, Touched};
use crate::trial::Trial;
use rayon::prelude::{IntoParallelIterator, ParallelIterator};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;
use world::arm::JointVector;
use world::environment::Environment;
use world::{AvoidanceMap, LabelForm, PoseChange};

/// Poses on the way of one step at which contacts are looked for are at most this far apart, at the fingertips \[m\].
const CONTACT_SPACING: f64 = 2e-3;

/// Distance of the fingertips from the hand frame, with some margin \[m\].
const HAND_SIZE: f64 = 0.1;

/// One session under way.
pub struct Session<'a> {
    environment: &'a Environment,
    policies: Policies<'a>,
    trial: &'a Trial,
    servo: &'a ServoConfig,
    deflector: Deflector,
    mediator: Mediator,
    stop: StopRule,
    joints: JointVector,
}

impl<'a> Session<'a> {
    /// At the start of a trial.
    pub fn new(
        environment: &'a Environment,
        config: &'a EvalConfig,
        policies: Policies<'a>,
        trial: &'a Trial,
    ) -> Self {
        Self {
            environment,
            policies,
            trial,
            servo: &config.servo,
            deflector: Deflector::new(&config.deflection, &environment.measuring_points),
            mediator: Mediator::new(&config.mediation, &environment.camera),
            stop: StopRule::new(&config.stop),
            joints: trial.start_joints,
        }
    }

    /// One pass through Figure 2.
    pub fn step(&mut self) -> Result<Step> {
        let Self { environment, trial, .. } = *self;
        let hand = environment.arm.robot_from_hand(&self.joints);
        let truth = Truth { scene: &trial.scene, robot_from_goal: &trial.robot_from_goal };
        let target = trial.scene.target_center();
        let mut seconds = StageSeconds::default();

        let current = timed(&mut seconds.render, || environment.wrist_image(&trial.scene, &hand));
        let view = View { current: &current, goal: &trial.goal_image, robot_from_hand: &hand };
        let desired = timed(&mut seconds.approach, || self.policies.approach.pose_change(&view, &truth))?;
        let risk = timed(&mut seconds.avoid, || self.policies.avoid.avoidance_map(&view, &truth))?;
        self.check(&risk)?;
        let step = self.servo.pace(&desired);
        let deflection = timed(&mut seconds.deflect, || self.deflector.deflect(&step, &risk, &hand.rotation));
        let command = timed(&mut seconds.qp, || {
            self.mediator.solve(&environment.arm, &self.joints, &deflection.motion, &target)
        });
        let touched = self.displace(&command.displacement);

        let robot_from_hand = environment.arm.robot_from_hand(&self.joints);
        Ok(Step {
            desired,
            deflected: deflection.motion,
            course: deflection.course,
            threshold: deflection.threshold,
            displacement: command.displacement,
            qp: command.status,
            slack: command.slack,
            robot_from_hand,
            joints: self.joints,
            touched,
            target_in_view: environment.camera.sees(&robot_from_hand, &target),
            within_limits: environment.arm.within_limits(&self.joints),
            seconds,
        })
    }

    /// Moves the joints, up to the first contact with an obstacle or the table.
    fn displace(&mut self, displacement: &JointVector) -> Touched {
        let Environment { arm, hand, .. } = self.environment;
        let start = self.joints;
        let (from, to) = (arm.robot_from_hand(&start), arm.robot_from_hand(&(start + displacement)));
        let motion = PoseChange::log(&from.inv_mul(&to));
        let way = motion.translation.norm() + motion.rotation.norm() * HAND_SIZE;
        let poses = (way / CONTACT_SPACING).ceil().max(1.0);
        let mut touched = Touched::default();
        for k in 1..=poses as usize {
            self.joints = start + displacement * (k as f64 / poses);
            touched.add(hand.contacts(&arm.robot_from_hand(&self.joints), &self.trial.scene));
            if touched.is_collision() {
                break;
            }
        }
        touched
    }

    fn check(&self, risk: &AvoidanceMap) -> Result<()> {
        let (found, expected) = (risk.values.len(), self.environment.measuring_points.directions().len());
        if found == expected { Ok(()) } else { Err(Error::MapSize { found, expected }) }
    }

    /// Steps until the session ends.
    pub fn run(mut self) -> Result<SessionRecord> {
        let mut steps: Vec<Step> = Vec::new();
        let outcome = loop {
            let step = self.step()?;
            steps.push(step);
            if let Some(outcome) = self.outcome(&steps) {
                break outcome;
            }
        };
        Ok(self.record(outcome, steps))
    }

    /// How the session ends after these steps, if it does.
    fn outcome(&mut self, steps: &[Step]) -> Option<Outcome> {
        let last = steps.last()?;
        let unseen = steps.iter().rev().take_while(|step| !step.target_in_view).count();
        let settles = self.stop.settles(&last.desired, last.course == Course::Kept);
        if !last.qp.is_solved() {
            Some(Outcome::Infeasible)
        } else if last.touched.is_collision() {
            Some(Outcome::Collided)
        } else if unseen >= self.servo.lost_steps {
            Some(Outcome::TargetLost)
        } else if settles {
            Some(Outcome::Converged)
        } else {
            (steps.len() >= self.servo.max_steps).then_some(Outcome::IterationLimit)
        }
    }

    fn record(self, outcome: Outcome, steps: Vec<Step>) -> SessionRecord {
        let Self { environment, trial, joints, .. } = self;
        let goal = trial.robot_from_goal;
        let end = environment.arm.robot_from_hand(&joints);
        let count = |holds: fn(&Step) -> bool| steps.iter().filter(|step| holds(step)).count();
        let mut seconds = StageSeconds::default();
        for step in &steps {
            seconds += step.seconds;
        }
        SessionRecord {
            index: trial.index,
            seed: trial.seed,
            outcome,
            scene: trial.scene.clone(),
            robot_from_start: environment.arm.robot_from_hand(&trial.start_joints),
            start_joints: trial.start_joints,
            robot_from_goal: goal,
            robot_from_final: end,
            final_error: LabelForm::Difference.label(&goal, &end).to_array(),
            position_error: (end.translation.vector - goal.translation.vector).norm(),
            orientation_error: end.rotation.angle_to(&goal.rotation),
            contacts: ContactCounts {
                obstacle: count(|step| step.touched.obstacle),
                target: count(|step| step.touched.target),
                table: count(|step| step.touched.table),
            },
            target_lost_steps: count(|step| !step.target_in_view),
            limit_violations: count(|step| !step.within_limits),
            seconds,
            steps,
        }
    }
}

/// Adds the time that `work` takes.
fn timed<T>(seconds: &mut f64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    *seconds += start.elapsed().as_secs_f64();
    result
}

/// Runs all sessions of a configuration, in parallel; the records come in the order of their indices and, times aside, do
/// not depend on the number of threads.
///
/// `progress` hears of every finished session, in the order in which they finish. Setting `stop` ends the run with
/// [`Error::Interrupted`] once the sessions under way are done.
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
    use crate::oracle::{ApproachOracle, AvoidOracle};
    use crate::policy::{ApproachPolicy, AvoidPolicy};
    use nalgebra::{Isometry3, Vector3};
    use rayon::ThreadPoolBuilder;
    use world::pose::HandPose;

    /// The sessions of Table 1 with a small camera: oracles do not look at images.
    fn config(sessions: usize) -> EvalConfig {
        let mut table: toml::Table = toml::from_str(include_str!("../../configs/eval/table1.toml")).unwrap();
        let world: toml::Table = toml::from_str(include_str!("../../configs/world.toml")).unwrap();
        table.insert("world".into(), world.into());
        let mut config: EvalConfig = table.try_into().unwrap();
        (config.world.camera.width, config.world.camera.height) = (64, 48);
        config.sessions = sessions;
        config.validate().unwrap();
        config
    }

    fn environment(config: &EvalConfig) -> Environment {
        Environment::new(&config.world).unwrap()
    }

    fn all(
        environment: &Environment,
        config: &EvalConfig,
        approach: &dyn ApproachPolicy,
    ) -> Result<Vec<SessionRecord>> {
        let avoid = AvoidOracle { environment };
        run_sessions(
            environment,
            config,
            Policies { approach, avoid: &avoid },
            &|_| (),
            &AtomicBool::new(false),
        )
    }

    /// Heads for a pose that it makes of the truth.
    struct HeadFor(fn(&Truth) -> Isometry3<f64>);

    impl ApproachPolicy for HeadFor {
        fn pose_change(&self, view: &View, truth: &Truth) -> Result<PoseChange> {
            Ok(LabelForm::Twist.label(view.robot_from_hand, &(self.0)(truth)))
        }
    }

    /// Always the same motion.
    struct Always([f64; 6]);

    impl ApproachPolicy for Always {
        fn pose_change(&self, _: &View, _: &Truth) -> Result<PoseChange> {
            Ok(PoseChange::from_array(self.0))
        }
    }

    /// Sees no risk, in a map of this size.
    struct Fearless(usize);

    impl AvoidPolicy for Fearless {
        fn avoidance_map(&self, _: &View, _: &Truth) -> Result<AvoidanceMap> {
            Ok(AvoidanceMap { values: vec![0.0; self.0] })
        }
    }

    #[test]
    fn with_oracles_every_session_reaches_its_goal_without_a_collision() {
        let config = config(40);
        let records = all(&environment(&config), &config, &ApproachOracle).unwrap();
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
        let turned = |record: &&SessionRecord| record.steps.iter().any(|step| step.course != Course::Kept);
        assert!(records.iter().filter(turned).count() > 10, "obstacles are in the way");
    }

    #[test]
    fn records_do_not_depend_on_the_number_of_threads() {
        let config = config(4);
        let environment = environment(&config);
        let run = |threads| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut records = pool.install(|| all(&environment, &config, &ApproachOracle)).unwrap();
            for record in &mut records {
                record.seconds = StageSeconds::default();
                record.steps.iter_mut().for_each(|step| step.seconds = StageSeconds::default());
            }
            records
        };
        assert_eq!(run(1), run(3));
    }

    #[test]
    fn a_hand_that_runs_into_an_obstacle_or_the_table_stops_there() {
        let mut config = config(1);
        config.obstacles.count = [1, 1];
        let environment = environment(&config);
        let into_obstacle = HeadFor(|truth| {
            let position = truth.scene.obstacles[0].robot_from_body.translation.vector;
            HandPose { position, angles: Vector3::zeros() }.robot_from_hand()
        });
        let policies = Policies { approach: &into_obstacle, avoid: &Fearless(180) };
        let records =
            run_sessions(&environment, &config, policies, &|_| (), &AtomicBool::new(false)).unwrap();
        assert_eq!((records[0].outcome, records[0].contacts.obstacle), (Outcome::Collided, 1));
        let depth = environment.hand.clearance(&records[0].robot_from_final, &records[0].scene);
        assert!(depth < 1e-9, "in contact");

        config.obstacles.count = [0, 0];
        let into_table = all(&environment, &config, &Always([0.0, 0.0, 0.3, 0.0, 0.0, 0.0])).unwrap();
        assert_eq!((into_table[0].outcome, into_table[0].contacts.table), (Outcome::Collided, 1));
    }

    #[test]
    fn a_target_that_leaves_the_image_is_lost_unless_the_program_keeps_it_in() {
        let mut config = config(1);
        config.servo.max_steps = 15;
        let environment = environment(&config);
        let look_away = Always([0.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let kept = &all(&environment, &config, &look_away).unwrap()[0];
        assert_eq!((kept.outcome, kept.target_lost_steps), (Outcome::IterationLimit, 0));
        config.mediation.slack_weight = 1e-12;
        let lost = &all(&environment, &config, &look_away).unwrap()[0];
        assert_eq!((lost.outcome, lost.target_lost_steps), (Outcome::TargetLost, config.servo.lost_steps));
    }

    #[test]
    fn sessions_end_at_the_iteration_limit() {
        let mut config = config(1);
        config.servo.max_steps = 3;
        let record = &all(&environment(&config), &config, &ApproachOracle).unwrap()[0];
        assert_eq!((record.outcome, record.steps.len()), (Outcome::IterationLimit, 3));
        assert!(record.seconds.total() > 0.0);
    }

    #[test]
    fn a_policy_that_answers_nonsense_ends_its_session_and_not_the_program() {
        let config = config(1);
        let environment = environment(&config);
        let record = &all(&environment, &config, &Always([f64::NAN; 6])).unwrap()[0];
        assert_eq!((record.outcome, record.steps.len()), (Outcome::Infeasible, 1));
        assert_eq!(record.robot_from_final, record.robot_from_start);

        let policies = Policies { approach: &ApproachOracle, avoid: &Fearless(7) };
        let wrong = run_sessions(&environment, &config, policies, &|_| (), &AtomicBool::new(false));
        assert!(matches!(wrong, Err(Error::MapSize { found: 7, expected: 180 })));
    }

    #[test]
    fn a_run_can_be_stopped() {
        let config = config(2);
        let environment = environment(&config);
        let policies = Policies { approach: &ApproachOracle, avoid: &Fearless(180) };
        let stopped = run_sessions(&environment, &config, policies, &|_| (), &AtomicBool::new(true));
        assert!(matches!(stopped, Err(Error::Interrupted { done: 0, total: 2 })));
    }
}
