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
use world::units::{deg, mm};
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
        steps.iter().for_each(|step| seconds += step.seconds);
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

impl ServoConfig {
    /// The part of a desired motion that one step covers.
    fn pace(&self, desired: &PoseChange) -> PoseChange {
        desired.scaled(self.gain).capped(mm(self.step_mm), deg(self.step_deg))
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
