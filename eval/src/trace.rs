//! What happened in a session, step by step (paper, Figure 8): the data behind tables and figures.

use crate::deflect::Course;
use crate::mediate::QpStatus;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};
use std::ops::AddAssign;
use world::arm::JointVector;
use world::{Contacts, PoseChange, Scene};

/// How a session ended. A value, not an error: sessions that fail are results, too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The loop settled, wherever that is: the final error says how well.
    Converged,
    /// The hand ran into an obstacle or the table, and stopped there.
    Collided,
    /// The target's centre left the image and stayed away.
    TargetLost,
    /// The quadratic program gave no displacement.
    Infeasible,
    /// The loop had not settled after the last step allowed.
    IterationLimit,
}

/// One pass through Figure 2. Motions are twists in the hand frame at the beginning of the step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// `v_g`: the whole way to the goal, as the approach policy sees it.
    pub desired: PoseChange,
    /// `v̂_g`: the step towards it, deflected.
    pub deflected: PoseChange,
    /// What became of its direction.
    pub course: Course,
    /// The threshold `t_g`.
    pub threshold: f64,
    /// `q`: the joint displacement asked for \[rad\].
    pub displacement: JointVector,
    /// How the quadratic program ended.
    pub qp: QpStatus,
    /// By how much the field-of-view rows gave way, in normalized image coordinates.
    pub slack: f64,
    /// Where the hand is at the end of the step.
    pub robot_from_hand: Isometry3<f64>,
    /// Joint angles there \[rad\].
    pub joints: JointVector,
    /// What the hand touched on its way.
    pub touched: Touched,
    /// Is the target's centre in the image at the end of the step?
    pub target_in_view: bool,
    /// Are all joints within their limits there?
    pub within_limits: bool,
    /// Time that each stage took.
    pub seconds: StageSeconds,
}

/// What the hand touched.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Touched {
    /// An obstacle.
    pub obstacle: bool,
    /// The target. The paper does not avoid it, so this ends no session.
    pub target: bool,
    /// The table.
    pub table: bool,
}

impl Touched {
    /// Adds what one pose touches.
    pub fn add(&mut self, contacts: Contacts) {
        self.obstacle |= contacts.obstacle;
        self.target |= contacts.target;
        self.table |= contacts.table;
    }

    /// Did the hand run into something that it must not touch?
    pub fn is_collision(self) -> bool {
        self.obstacle || self.table
    }
}

/// Number of steps in which the hand touched something.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContactCounts {
    /// An obstacle.
    pub obstacle: usize,
    /// The target.
    pub target: usize,
    /// The table.
    pub table: usize,
}

/// Wall-clock time by stage \[s\].
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct StageSeconds {
    /// Rendering the current image.
    pub render: f64,
    /// The approach policy.
    pub approach: f64,
    /// The avoid policy.
    pub avoid: f64,
    /// Deflection.
    pub deflect: f64,
    /// The quadratic program.
    pub qp: f64,
}

impl StageSeconds {
    /// All stages.
    pub fn total(&self) -> f64 {
        self.render + self.approach + self.avoid + self.deflect + self.qp
    }
}

impl AddAssign for StageSeconds {
    fn add_assign(&mut self, other: Self) {
        self.render += other.render;
        self.approach += other.approach;
        self.avoid += other.avoid;
        self.deflect += other.deflect;
        self.qp += other.qp;
    }
}

/// A whole session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SessionRecord {
    /// Its index in the evaluation.
    pub index: usize,
    /// Seed of the evaluation; together with the index it gives the same session again.
    pub seed: u64,
    /// How it ended.
    pub outcome: Outcome,
    /// What stood on the table.
    pub scene: Scene,
    /// Where the hand started.
    pub robot_from_start: Isometry3<f64>,
    /// Joint angles there \[rad\].
    pub start_joints: JointVector,
    /// Where the goal image was taken.
    pub robot_from_goal: Isometry3<f64>,
    /// Where the hand ended.
    pub robot_from_final: Isometry3<f64>,
    /// Final pose minus goal pose, `(x y z φ θ ψ)` in the robot frame, as in the paper's Table 1 \[m\], \[rad\].
    pub final_error: [f64; 6],
    /// Distance of the final position from the goal \[m\].
    pub position_error: f64,
    /// Angle of the turn that is left \[rad\].
    pub orientation_error: f64,
    /// Steps with contacts.
    pub contacts: ContactCounts,
    /// Steps that ended with the target's centre outside the image.
    pub target_lost_steps: usize,
    /// Steps that ended with a joint outside its limits.
    pub limit_violations: usize,
    /// Time by stage, summed over the steps.
    pub seconds: StageSeconds,
    /// The steps.
    pub steps: Vec<Step>,
}
