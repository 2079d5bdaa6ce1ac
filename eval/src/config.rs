//! Configuration of an evaluation: a file in `configs/eval/`. It is complete; no key has a default.

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
    /// Seed of all random draws; 0 is a valid seed.
    pub seed: u64,
    /// Number of sessions (paper: 40).
    pub sessions: usize,
    /// The two policies.
    pub policies: PolicyConfig,
    /// The virtual environment.
    pub world: WorldConfig,
    /// The object to grasp.
    pub target: TargetConfig,
    /// The obstacles.
    pub obstacles: ObstacleConfig,
    /// Ranges of start poses (`current`) and of goal poses (`goal`).
    pub motions: Vec<MotionConfig>,
    /// Requirements on start and goal.
    pub rejection: RejectionConfig,
    /// Smallest distance of the hand from every obstacle, and above the table, at start and goal. Goals without clearance for
    /// the fingers are rejected.
    pub clearance_mm: f64,
    /// Gain and limits of the loop.
    pub servo: ServoConfig,
    /// Stop rule.
    pub stop: StopConfig,
    /// Avoidance (paper, Section 4.3).
    pub deflection: DeflectionConfig,
    /// The quadratic program (paper, Section 5).
    pub mediation: MediationConfig,
}

/// The two policies: `oracle` for ground truth, or a model, which the caller resolves.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyConfig {
    /// In the role of `CNN_approach`.
    pub approach: String,
    /// In the role of `CNN_avoid`.
    pub avoid: String,
}

/// Gain and limits of the loop. The paper gives neither gain nor step caps. However, the networks predict the whole motion to
/// the goal, and the paper's example takes 40 steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ServoConfig {
    /// Fraction of the desired motion that one step covers.
    pub gain: f64,
    /// Largest translation of one step.
    pub step_mm: f64,
    /// Largest rotation of one step.
    pub step_deg: f64,
    /// Largest number of steps in a session.
    pub max_steps: usize,
    /// Consecutive steps with the target's center outside the image after which the target counts as lost.
    pub lost_steps: usize,
}

/// Stop rule. It depends only on the desired motions of the approach policy, never on the true pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StopConfig {
    /// A desired motion below this translation and below `settled_deg` is negligible.
    pub settled_mm: f64,
    /// See `settled_mm`.
    pub settled_deg: f64,
    /// Consecutive negligible motions after which the session ends.
    pub settled_steps: usize,
    /// Below this translation and below `near_deg`, the session may end because the desired motion no longer shrinks.
    pub near_mm: f64,
    /// See `near_mm`.
    pub near_deg: f64,
    /// Steps without a desired motion at least 10 % below the smallest so far after which the session ends.
    pub patience_steps: usize,
}

/// Choice of a direction from the avoidance map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DeflectionMode {
    /// As printed: always the direction of a measuring point, even with no obstacle in the way.
    Paper,
    /// The desired direction if its own avoidance value is below the threshold, otherwise that of a measuring point.
    Keep,
}

/// Avoidance (paper, Section 4.3).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeflectionConfig {
    /// Choice of a direction from the avoidance map.
    pub mode: DeflectionMode,
    /// `t_g` in the first step. Directions with a lower avoidance value are admitted.
    pub threshold: f64,
    /// `ε`: increase of `t_g` at a deadlock.
    pub epsilon: f64,
    /// Upper bound of `t_g`. At 1 every direction is admitted.
    pub max_threshold: f64,
    /// Largest cosine between desired and admitted direction that counts as a deadlock (paper: 0). If it is above half the
    /// servo gain, every step gets closer to the goal or raises `t_g`, so that the loop cannot circle.
    pub min_progress: f64,
}

/// The quadratic program (paper, Section 5).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MediationConfig {
    /// Translation weighted like a rotation by one radian.
    pub rotation_weight_mm: f64,
    /// `λ`: cost of the squared joint displacement \[m²/rad²\].
    pub damping: f64,
    /// Duration of one step, for the velocity limits.
    pub period_s: f64,
    /// Margin on each side of the image that the target's center must not enter, as a fraction of width and height.
    pub image_margin: f64,
    /// Cost of leaving that rectangle by one focal length \[m²\].
    pub slack_weight: f64,
}

impl EvalConfig {
    /// Rejects invalid values. The error names the key.
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

    /// Returns the smallest distance from every obstacle, and above the table, at start and goal \[m\].
    pub fn clearance(&self) -> f64 {
        mm(self.clearance_mm)
    }
}

impl ServoConfig {
    /// Returns the part of a desired motion that one step covers.
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
    /// Returns the bounds of a negligible motion \[m\], \[rad\].
    pub fn settled(&self) -> (f64, f64) {
        (mm(self.settled_mm), deg(self.settled_deg))
    }

    /// Returns the bounds of a motion that no longer has to shrink \[m\], \[rad\].
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
    /// Returns the translation weighted like a rotation by one radian \[m\].
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
