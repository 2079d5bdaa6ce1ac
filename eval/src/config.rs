//! What a file in `configs/eval/` says. It is complete: no key has a default.

use crate::error::{Error, Result};
use datagen::config::{MotionConfig, ObstacleConfig, RejectionConfig, TargetConfig};
use serde::{Deserialize, Serialize};
use std::fmt::Display;
use world::units::{deg, mm};
use world::{PoseChange, WorldConfig};

/// A set of servo sessions (paper, Section 6.4).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EvalConfig {
    /// Seed of all random draws; 0 is a seed like others.
    pub seed: u64,
    /// Number of sessions (paper: 40).
    pub sessions: usize,
    /// Who answers in them.
    pub policies: PolicyConfig,
    /// The virtual environment.
    pub world: WorldConfig,
    /// The object to be grasped.
    pub target: TargetConfig,
    /// What stands in the way.
    pub obstacles: ObstacleConfig,
    /// Where sessions start (`current`) and where their goal images are taken (`goal`).
    pub motions: Vec<MotionConfig>,
    /// What start and goal must fulfill.
    pub rejection: RejectionConfig,
    /// Least distance of the hand from every obstacle, and above the table, at start and goal: a goal that leaves the
    /// fingers no room is none.
    pub clearance_mm: f64,
    /// The loop.
    pub servo: ServoConfig,
    /// When the loop has settled.
    pub stop: StopConfig,
    /// Avoidance (paper, Section 4.3).
    pub deflection: DeflectionConfig,
    /// The quadratic program (paper, Section 5).
    pub mediation: MediationConfig,
}

/// Who answers in a session: `oracle` for ground truth, or a model, which the caller resolves.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyConfig {
    /// In the place of `CNN_approach`.
    pub approach: String,
    /// In the place of `CNN_avoid`.
    pub avoid: String,
}

/// The loop around the two networks. The paper names neither gain nor step cap, but the networks' output is the whole way
/// to the goal and the paper's sessions take 40 steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoConfig {
    /// Share of the desired motion that one step covers.
    pub gain: f64,
    /// Longest translation of one step.
    pub step_mm: f64,
    /// Largest rotation of one step.
    pub step_deg: f64,
    /// Steps after which a session ends.
    pub max_steps: usize,
    /// Steps in a row with the target's centre outside the image after which the target counts as lost.
    pub lost_steps: usize,
}

/// When the loop has settled. It must not look at the true pose: it sees only what the approach policy asks for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StopConfig {
    /// A desired motion below this translation and `settled_deg` is none.
    pub settled_mm: f64,
    /// See `settled_mm`.
    pub settled_deg: f64,
    /// So many such steps in a row end the session.
    pub settled_steps: usize,
    /// Below this translation and `near_deg` a desired motion that no longer shrinks is as small as it gets.
    pub near_mm: f64,
    /// See `near_mm`.
    pub near_deg: f64,
    /// So many steps without a desired motion 10 % smaller than all before end the session.
    pub patience_steps: usize,
}

/// How directions are taken from the avoidance map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DeflectionMode {
    /// As printed: always one of the measuring points, even with nothing in the way.
    Paper,
    /// The desired direction where its own avoidance value is below the threshold, a measuring point otherwise.
    Keep,
}

/// Avoidance (paper, Section 4.3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeflectionConfig {
    /// How directions are taken from the avoidance map.
    pub mode: DeflectionMode,
    /// `t_g` of the first step; directions with a lower avoidance value are admitted.
    pub threshold: f64,
    /// `ε`, by which a deadlock raises `t_g`.
    pub epsilon: f64,
    /// `t_g` rises to this and no further; at 1 every direction is admitted.
    pub max_threshold: f64,
    /// Cosine between desired and admitted direction up to which a step counts as deadlocked (paper: 0). Above half the
    /// servo gain, every step either comes nearer to the goal or raises `t_g`, so that the loop cannot circle.
    pub min_progress: f64,
}

/// The quadratic program (paper, Section 5).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MediationConfig {
    /// Translation that counts as much as one radian.
    pub rotation_weight_mm: f64,
    /// `λ`: price of the squared joint displacement \[m²/rad²\].
    pub damping: f64,
    /// Time that one step takes, for the velocity limits.
    pub period_s: f64,
    /// Share of the image's width and height, on each side, that the target's centre must not enter.
    pub image_margin: f64,
    /// Price of leaving that rectangle by one focal length \[m²\].
    pub slack_weight: f64,
}

impl EvalConfig {
    /// Refuses values that make no sessions; names the key.
    pub fn validate(&self) -> Result<()> {
        require("sessions", (1..=1_000_000).contains(&self.sessions), self.sessions, "1 to 1000000")?;
        for (key, policy) in
            [("policies.approach", &self.policies.approach), ("policies.avoid", &self.policies.avoid)]
        {
            require(key, !policy.is_empty(), policy, "oracle or a model")?;
        }
        self.world.validate()?;
        self.target.validate()?;
        self.obstacles.validate()?;
        MotionConfig::validate(&self.motions)?;
        require("motions", !self.motions.is_empty(), "[]", "at least one")?;
        for (i, motion) in self.motions.iter().enumerate() {
            require(format!("motions[{i}].goal"), motion.goal.is_some(), "nothing", "a range")?;
        }
        self.rejection.validate()?;
        require("clearance_mm", (0.0..=1000.0).contains(&self.clearance_mm), self.clearance_mm, "0 to 1000")?;
        self.servo.validate()?;
        self.stop.validate()?;
        self.deflection.validate()?;
        self.mediation.validate()
    }

    /// Least distance from every obstacle, and above the table, at start and goal \[m\].
    pub fn clearance(&self) -> f64 {
        mm(self.clearance_mm)
    }
}

impl ServoConfig {
    /// The part of a desired motion that one step covers.
    pub fn pace(&self, desired: &PoseChange) -> PoseChange {
        desired.scaled(self.gain).capped(mm(self.step_mm), deg(self.step_deg))
    }

    fn validate(&self) -> Result<()> {
        require("servo.gain", self.gain > 0.0 && self.gain <= 1.0, self.gain, "more than 0 and at most 1")?;
        require(
            "servo.step_mm",
            self.step_mm > 0.0 && self.step_mm <= 1000.0,
            self.step_mm,
            "more than 0, at most 1000",
        )?;
        require(
            "servo.step_deg",
            self.step_deg > 0.0 && self.step_deg <= 90.0,
            self.step_deg,
            "more than 0, at most 90",
        )?;
        require("servo.max_steps", (1..=100_000).contains(&self.max_steps), self.max_steps, "1 to 100000")?;
        require("servo.lost_steps", self.lost_steps >= 1, self.lost_steps, "at least 1")
    }
}

impl StopConfig {
    /// Bounds of a desired motion that is none \[m\], \[rad\].
    pub fn settled(&self) -> (f64, f64) {
        (mm(self.settled_mm), deg(self.settled_deg))
    }

    /// Bounds of a desired motion that need not shrink any more \[m\], \[rad\].
    pub fn near(&self) -> (f64, f64) {
        (mm(self.near_mm), deg(self.near_deg))
    }

    fn validate(&self) -> Result<()> {
        let sizes = [
            ("stop.settled_mm", self.settled_mm),
            ("stop.settled_deg", self.settled_deg),
            ("stop.near_mm", self.near_mm),
            ("stop.near_deg", self.near_deg),
        ];
        for (key, size) in sizes {
            require(key, (0.0..=1000.0).contains(&size), size, "0 to 1000")?;
        }
        require("stop.settled_steps", self.settled_steps >= 1, self.settled_steps, "at least 1")?;
        require("stop.patience_steps", self.patience_steps >= 1, self.patience_steps, "at least 1")
    }
}

impl DeflectionConfig {
    fn validate(&self) -> Result<()> {
        let (threshold, most) = (self.threshold, self.max_threshold);
        require("deflection.threshold", (0.0..=1.0).contains(&threshold), threshold, "0 to 1")?;
        let holds = (threshold..=1.0).contains(&most);
        require("deflection.max_threshold", holds, most, "deflection.threshold to 1")?;
        require(
            "deflection.epsilon",
            self.epsilon > 0.0 && self.epsilon <= 1.0,
            self.epsilon,
            "more than 0, at most 1",
        )?;
        let progress = self.min_progress;
        require(
            "deflection.min_progress",
            (0.0..1.0).contains(&progress),
            progress,
            "at least 0 and less than 1",
        )?;
        let literal = self.mode == DeflectionMode::Keep || progress == 0.0;
        require("deflection.min_progress", literal, progress, "0 with deflection.mode = \"paper\"")
    }
}

impl MediationConfig {
    /// Translation that counts as much as one radian \[m\].
    pub fn rotation_weight(&self) -> f64 {
        mm(self.rotation_weight_mm)
    }

    fn validate(&self) -> Result<()> {
        let positive = [
            ("mediation.rotation_weight_mm", self.rotation_weight_mm),
            ("mediation.damping", self.damping),
            ("mediation.period_s", self.period_s),
            ("mediation.slack_weight", self.slack_weight),
        ];
        for (key, value) in positive {
            require(key, value > 0.0 && value.is_finite(), value, "more than 0")?;
        }
        let margin = self.image_margin;
        require(
            "mediation.image_margin",
            (0.0..0.5).contains(&margin),
            margin,
            "at least 0 and less than 0.5",
        )
    }
}

fn require(key: impl Into<String>, holds: bool, value: impl Display, expected: &'static str) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::Config { key: key.into(), value: value.to_string(), expected }) }
}
