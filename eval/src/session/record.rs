//! Record of a session, step by step: the data behind tables and figures.

use super::deflect::DeflectionKind;
use super::displace::Touched;
use super::outcome::Outcome;
use super::timing::StageSeconds;
use crate::mediate::quadratic_program::QpStatus;
use crate::trial::Trial;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use world::arm::JointVector;
use world::{Environment, LabelForm, PoseChange, Scene};

/// Record of one pass through Figure 2. Motions are twists in the hand frame at the beginning of the step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// `v_g`: the whole motion to the goal, from the approach policy.
    pub desired: PoseChange,
    /// `v̂_g`: the part of it that one step covers, deflected.
    pub deflected: PoseChange,
    /// Effect of deflection on the direction.
    #[serde(rename = "course")]
    pub deflection: DeflectionKind,
    /// The threshold `t_g`.
    pub threshold: f64,
    /// `q`: the joint displacement commanded \[rad\].
    pub displacement: JointVector,
    /// Status of the quadratic program.
    pub qp: QpStatus,
    /// Largest violation of the field of view, in normalized image coordinates.
    pub slack: f64,
    /// Hand pose at the end of the step.
    pub robot_from_hand: Isometry3<f64>,
    /// Joint angles at the end of the step \[rad\].
    pub joints: JointVector,
    /// Contacts during the step.
    pub touched: Touched,
    /// Whether the target's center is in the image at the end of the step.
    pub target_in_view: bool,
    /// Whether all joints are within their limits at the end of the step.
    pub within_limits: bool,
    /// Wall-clock time.
    pub seconds: StageSeconds,
}

/// Numbers of steps with contacts.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContactCounts {
    /// With an obstacle.
    pub obstacle: usize,
    /// With the target.
    pub target: usize,
    /// With the table.
    pub table: usize,
}

/// Record of a whole session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SessionRecord {
    /// Index in the evaluation.
    pub index: usize,
    /// Seed of the evaluation. Seed and index determine the trial.
    pub seed: u64,
    /// How it ended.
    pub outcome: Outcome,
    /// The scene.
    pub scene: Scene,
    /// Hand pose at the start.
    pub robot_from_start: Isometry3<f64>,
    /// Joint angles at the start \[rad\].
    pub start_joints: JointVector,
    /// Hand pose at which the goal image was taken.
    pub robot_from_goal: Isometry3<f64>,
    /// Hand pose at the end.
    pub robot_from_final: Isometry3<f64>,
    /// Final pose minus goal pose, `(x y z φ θ ψ)` in the robot frame, as in the paper's Table 1 \[m\], \[rad\].
    pub final_error: [f64; 6],
    /// Distance between final and goal position \[m\].
    pub position_error: f64,
    /// Angle between final and goal orientation \[rad\].
    pub orientation_error: f64,
    /// Steps with contacts.
    pub contacts: ContactCounts,
    /// Steps that ended with the target's center outside the image.
    pub target_lost_steps: usize,
    /// Steps that ended with a joint outside its limits.
    pub limit_violations: usize,
    /// Wall-clock time, summed over the steps.
    pub seconds: StageSeconds,
    /// The steps.
    pub steps: Vec<Step>,
}

impl SessionRecord {
    /// Summarizes the steps of a session that has ended.
    pub fn new(environment: &Environment, trial: &Trial, outcome: Outcome, steps: Vec<Step>) -> Self {
        let start = environment.arm.robot_from_hand(&trial.start_joints);
        let goal = trial.robot_from_goal;
        let end = steps.last().map_or(start, |step| step.robot_from_hand);
        let count = |holds: fn(&Step) -> bool| steps.iter().filter(|step| holds(step)).count();
        let mut seconds = StageSeconds::default();
        for step in &steps {
            seconds += step.seconds;
        }
        Self {
            index: trial.index,
            seed: trial.seed,
            outcome,
            scene: trial.scene.clone(),
            robot_from_start: start,
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
