//! A servo session: the loop of the paper's Figure 2 on the arm, in the virtual environment.

pub mod deflect;
pub mod displace;
pub mod outcome;
pub mod record;
pub mod stop;
pub mod timing;

use crate::config::{EvalConfig, ServoConfig};
use crate::error::Result;
use crate::mediate::{Command, Mediator};
use crate::policy::{ApproachPolicy, AvoidPolicy, Policies, View};
use crate::trial::Trial;
use deflect::{Deflection, DeflectionKind, Deflector};
use displace::{Touched, displace};
use nalgebra::Point3;
use outcome::Outcome;
use record::{SessionRecord, Step};
use stop::StopRule;
use timing::{StageSeconds, timed};
use world::arm::JointVector;
use world::{Environment, PoseChange};

/// A running session.
pub struct Session<'a> {
    environment: &'a Environment,
    trial: &'a Trial,
    servo: &'a ServoConfig,
    approach: Box<dyn ApproachPolicy + 'a>,
    avoid: Box<dyn AvoidPolicy + 'a>,
    deflector: Deflector,
    mediator: Mediator,
    stop: StopRule,
    /// Center of the target, which the mediator keeps in view.
    target: Point3<f64>,
    joints: JointVector,
    /// Time of the stages of the current step.
    seconds: StageSeconds,
}

impl<'a> Session<'a> {
    /// Places the arm at the start of a trial and makes its policies.
    pub fn new(
        environment: &'a Environment,
        config: &'a EvalConfig,
        policies: Policies<'a>,
        trial: &'a Trial,
    ) -> Self {
        Self {
            environment,
            trial,
            servo: &config.servo,
            approach: policies.approach.for_trial(environment, trial),
            avoid: policies.avoid.for_trial(environment, trial),
            deflector: Deflector::new(&config.deflection, &environment.measuring_points),
            mediator: Mediator::new(&config.mediation, &environment.camera),
            stop: StopRule::new(&config.stop),
            target: trial.scene.target_center(),
            joints: trial.start_joints,
            seconds: StageSeconds::default(),
        }
    }

    /// Runs one pass through Figure 2.
    pub fn step(&mut self) -> Result<Step> {
        let Self { environment, trial, servo, target, joints, .. } = *self;
        let Environment { arm, camera, .. } = environment;
        let (hand, goal, time) = (arm.robot_from_hand(&joints), &trial.goal_image, &mut self.seconds);
        let current = timed(&mut time.render, || environment.wrist_image(&trial.scene, &hand));
        let view = View { current: &current, goal, joints: &joints, robot_from_hand: &hand, camera };
        // v_g, Section 4.1
        let desired = timed(&mut time.approach, || self.approach.pose_change(&view))?;
        // G, Section 4.2
        let risk = timed(&mut time.avoid, || self.avoid.avoidance_map(&view))?;
        // v̂_g, Eq. (2), (3)
        let paced = servo.pace(&desired);
        let deflection = timed(&mut time.deflect, || self.deflector.deflect(&paced, &risk, &hand.rotation))?;
        // q, Eq. (4)-(8)
        let command = timed(&mut time.qp, || self.mediator.solve(arm, &joints, &deflection.motion, &target));
        let touched = displace(environment, &trial.scene, &mut self.joints, &command.displacement);
        Ok(self.record(desired, &deflection, &command, touched))
    }

    /// Returns the record of the step that has just displaced the joints.
    fn record(
        &mut self,
        desired: PoseChange,
        deflection: &Deflection,
        command: &Command,
        touched: Touched,
    ) -> Step {
        let Self { environment: Environment { arm, camera, .. }, target, joints, .. } = *self;
        let robot_from_hand = arm.robot_from_hand(&joints);
        Step {
            desired,
            deflected: deflection.motion,
            deflection: deflection.kind,
            threshold: deflection.threshold,
            displacement: command.displacement,
            qp: command.status,
            slack: command.slack,
            robot_from_hand,
            joints,
            touched,
            target_in_view: camera.sees(&robot_from_hand, &target),
            within_limits: arm.within_limits(&joints),
            seconds: std::mem::take(&mut self.seconds),
        }
    }

    /// Runs the session to its end.
    pub fn run(mut self) -> Result<SessionRecord> {
        let mut steps: Vec<Step> = Vec::new();
        let outcome = loop {
            let step = self.step()?;
            steps.push(step);
            if let Some(outcome) = self.outcome(&steps) {
                break outcome;
            }
        };
        Ok(SessionRecord::new(self.environment, self.trial, outcome, steps))
    }

    /// Returns how the session ends after these steps, or `None` if it continues.
    fn outcome(&mut self, steps: &[Step]) -> Option<Outcome> {
        let last = steps.last()?;
        let unseen = steps.iter().rev().take_while(|step| !step.target_in_view).count();
        let settles = self.stop.settles(&last.desired, last.deflection == DeflectionKind::Kept);
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;
    use crate::fixture::eval_config;
    use crate::policy::oracle::Oracle;
    use crate::policy::{ApproachFactory, AvoidFactory};
    use nalgebra::{Isometry3, Vector3};
    use world::pose::HandPose;
    use world::{AvoidanceMap, LabelForm};

    fn environment(config: &EvalConfig) -> Environment {
        Environment::new(&config.world).unwrap()
    }

    /// Runs the first session of a configuration.
    fn run(
        config: &EvalConfig,
        approach: &dyn ApproachFactory,
        avoid: &dyn AvoidFactory,
    ) -> Result<SessionRecord> {
        let environment = environment(config);
        let trial = Trial::draw(&environment, config, 0)?;
        Session::new(&environment, config, Policies { approach, avoid }, &trial).run()
    }

    /// Heads for a pose computed from the trial.
    struct HeadFor(fn(&Trial) -> Isometry3<f64>);

    struct Heading(Isometry3<f64>);

    impl ApproachFactory for HeadFor {
        fn for_trial<'a>(&'a self, _: &'a Environment, trial: &'a Trial) -> Box<dyn ApproachPolicy + 'a> {
            Box::new(Heading((self.0)(trial)))
        }
    }

    impl ApproachPolicy for Heading {
        fn pose_change(&mut self, view: &View) -> Result<PoseChange> {
            Ok(LabelForm::Twist.label(view.robot_from_hand, &self.0))
        }
    }

    /// Desires the same motion at every step.
    struct Always([f64; 6]);

    impl ApproachFactory for Always {
        fn for_trial<'a>(&'a self, _: &'a Environment, _: &'a Trial) -> Box<dyn ApproachPolicy + 'a> {
            Box::new(self)
        }
    }

    impl ApproachPolicy for &Always {
        fn pose_change(&mut self, _: &View) -> Result<PoseChange> {
            Ok(PoseChange::from_array(self.0))
        }
    }

    /// Sees no risk. The map has this many values.
    struct Fearless(usize);

    impl AvoidFactory for Fearless {
        fn for_trial<'a>(&'a self, _: &'a Environment, _: &'a Trial) -> Box<dyn AvoidPolicy + 'a> {
            Box::new(self)
        }
    }

    impl AvoidPolicy for &Fearless {
        fn avoidance_map(&mut self, _: &View) -> Result<AvoidanceMap> {
            Ok(AvoidanceMap { values: vec![0.0; self.0] })
        }
    }

    /// Desires a motion that grows by a millimeter at each call.
    struct Counting;

    struct Calls(usize);

    impl ApproachFactory for Counting {
        fn for_trial<'a>(&'a self, _: &'a Environment, _: &'a Trial) -> Box<dyn ApproachPolicy + 'a> {
            Box::new(Calls(0))
        }
    }

    impl ApproachPolicy for Calls {
        fn pose_change(&mut self, _: &View) -> Result<PoseChange> {
            self.0 += 1;
            Ok(PoseChange::from_array([0.0, 0.0, -1e-3 * self.0 as f64, 0.0, 0.0, 0.0]))
        }
    }

    #[test]
    fn a_policy_keeps_its_state_within_a_session_and_not_beyond() {
        let mut config = eval_config(1);
        config.servo.max_steps = 3;
        for _ in 0..2 {
            let record = run(&config, &Counting, &Fearless(180)).unwrap();
            let desired: Vec<f64> = record.steps.iter().map(|step| step.desired.translation.z).collect();
            assert_eq!(desired, [-1e-3, -2e-3, -3e-3]);
        }
    }

    #[test]
    fn a_hand_that_runs_into_an_obstacle_or_the_table_stops_there() {
        let mut config = eval_config(1);
        config.obstacles.count = [1, 1];
        let into_obstacle = HeadFor(|trial| {
            let position = trial.scene.obstacles[0].robot_from_body.translation.vector;
            HandPose { position, angles: Vector3::zeros() }.robot_from_hand()
        });
        let record = run(&config, &into_obstacle, &Fearless(180)).unwrap();
        assert_eq!((record.outcome, record.contacts.obstacle), (Outcome::Collided, 1));
        let depth = environment(&config).hand.clearance(&record.robot_from_final, &record.scene);
        assert!(depth < 1e-9, "in contact");

        config.obstacles.count = [0, 0];
        let into_table = run(&config, &Always([0.0, 0.0, 0.3, 0.0, 0.0, 0.0]), &Oracle).unwrap();
        assert_eq!((into_table.outcome, into_table.contacts.table), (Outcome::Collided, 1));
    }

    #[test]
    fn a_target_that_leaves_the_image_is_lost_unless_the_program_keeps_it_in() {
        let mut config = eval_config(1);
        config.servo.max_steps = 15;
        let look_away = Always([0.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let kept = run(&config, &look_away, &Oracle).unwrap();
        assert_eq!((kept.outcome, kept.target_lost_steps), (Outcome::IterationLimit, 0));
        config.mediation.slack_weight = 1e-12;
        let lost = run(&config, &look_away, &Oracle).unwrap();
        assert_eq!((lost.outcome, lost.target_lost_steps), (Outcome::TargetLost, config.servo.lost_steps));
    }

    #[test]
    fn sessions_end_at_the_iteration_limit() {
        let mut config = eval_config(1);
        config.servo.max_steps = 3;
        let record = run(&config, &Oracle, &Oracle).unwrap();
        assert_eq!((record.outcome, record.steps.len()), (Outcome::IterationLimit, 3));
        assert!(record.seconds.total() > 0.0);
        let stages = record.steps.iter().map(|step| step.seconds.total()).sum::<f64>();
        assert!((stages - record.seconds.total()).abs() < 1e-9, "each step has its own times");
    }

    #[test]
    fn a_policy_that_answers_nonsense_ends_its_session_and_not_the_program() {
        let config = eval_config(1);
        let record = run(&config, &Always([f64::NAN; 6]), &Oracle).unwrap();
        assert_eq!((record.outcome, record.steps.len()), (Outcome::Infeasible, 1));
        assert_eq!(record.robot_from_final, record.robot_from_start);

        let wrong = run(&config, &Oracle, &Fearless(7));
        assert!(matches!(wrong, Err(Error::MapSize { found: 7, expected: 180 })));
    }
}
