//! Hand poses before and after a motion.

use super::validation::{Result, require};
use serde::{Deserialize, Serialize};

/// A motion: a range of current poses and, for an approach, a range of goal poses.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionConfig {
    /// Name, as recorded in the rows.
    pub name: String,
    /// Share of the examples; all shares add up to 1.
    pub share: f64,
    /// Range of current poses.
    pub current: RangeConfig,
    /// Range of goal poses; absent in a dataset of avoidance maps.
    pub goal: Option<RangeConfig>,
}

impl MotionConfig {
    /// Returns the ranges of the hand poses, in the order of the poses in a row.
    pub fn ranges(&self) -> impl Iterator<Item = &RangeConfig> {
        std::iter::once(&self.current).chain(&self.goal)
    }
}

/// A range of hand poses (paper, Section 6.2).
///
/// Half-widths, along the axes of the robot frame, around the pose that looks straight down from a reference point above
/// the center of the target.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangeConfig {
    /// Height of the reference point above the center of the target.
    pub reference_mm: f64,
    /// Half-width along x (forward).
    pub x_mm: f64,
    /// Half-width along y (left).
    pub y_mm: f64,
    /// Half-width along z (up).
    pub z_mm: f64,
    /// Half-width of `φ`, about x.
    pub phi_deg: f64,
    /// Half-width of `θ`, about y.
    pub theta_deg: f64,
    /// Half-width of `ψ`, about z.
    pub psi_deg: f64,
}

impl MotionConfig {
    /// Checks a list of motions; an error names the key.
    pub fn validate(motions: &[Self]) -> Result<()> {
        for (i, motion) in motions.iter().enumerate() {
            require(format!("motions[{i}].name"), !motion.name.is_empty(), &motion.name, "a name")?;
            require(format!("motions[{i}].share"), motion.share > 0.0, motion.share, "more than 0")?;
            motion.current.validate(&format!("motions[{i}].current"))?;
            if let Some(goal) = &motion.goal {
                goal.validate(&format!("motions[{i}].goal"))?;
            }
        }
        let total: f64 = motions.iter().map(|motion| motion.share).sum();
        require("motions", (total - 1.0).abs() < 1e-9, format!("shares that add up to {total}"), "1")
    }
}

impl RangeConfig {
    fn validate(&self, key: &str) -> Result<()> {
        let distances = [
            ("reference_mm", self.reference_mm),
            ("x_mm", self.x_mm),
            ("y_mm", self.y_mm),
            ("z_mm", self.z_mm),
        ];
        for (name, value) in distances {
            require(format!("{key}.{name}"), (0.0..=2000.0).contains(&value), value, "0 to 2000")?;
        }
        // Within these limits, the six numbers of a pose are unique.
        let angles = [
            ("phi_deg", self.phi_deg, 180.0, "0 to 180"),
            ("theta_deg", self.theta_deg, 80.0, "0 to 80"),
            ("psi_deg", self.psi_deg, 180.0, "0 to 180"),
        ];
        for (name, value, limit, expected) in angles {
            require(format!("{key}.{name}"), (0.0..=limit).contains(&value), value, expected)?;
        }
        Ok(())
    }
}
