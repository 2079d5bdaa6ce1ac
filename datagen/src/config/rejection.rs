//! Conditions that an example must satisfy.

use super::validation::{Result, require};
use serde::{Deserialize, Serialize};

/// Conditions that an example must satisfy, besides being within reach of the arm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RejectionConfig {
    /// Maximum number of draws per example; when they are exhausted, generation fails.
    pub tries: u32,
    /// Minimum fraction of each image that shows the target. The center of the target must be in the image as well.
    pub min_target_area: f64,
    /// Obstructions that the hand must not touch in any of its poses.
    pub clear_of: Vec<Obstruction>,
}

/// Something that the hand can touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Obstruction {
    /// The table.
    Table,
    /// Any obstacle.
    Obstacles,
    /// The target.
    Target,
}

impl RejectionConfig {
    /// Checks every value; an error names the key.
    pub fn validate(&self) -> Result<()> {
        require("rejection.tries", (1..=1_000_000).contains(&self.tries), self.tries, "1 to 1000000")?;
        let area = self.min_target_area;
        require("rejection.min_target_area", (0.0..1.0).contains(&area), area, "at least 0 and less than 1")
    }
}
