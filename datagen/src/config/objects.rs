//! What a configuration says of the objects on the table: target and obstacles.

use crate::config::{require, require_interval};
use crate::error::Result;
use serde::{Deserialize, Serialize};

/// Shape of an object on the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ShapeName {
    /// A box: long side along x, short side along y.
    Cuboid,
    /// An upright cylinder; the short side is its diameter.
    Cylinder,
    /// A sphere; the short side is its diameter.
    Sphere,
}

/// What the target is and where it stands; `[from, to]` are drawn evenly.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TargetConfig {
    /// Shapes, equally often.
    pub shapes: Vec<ShapeName>,
    /// Side along y, which the fingers close across.
    pub short_side_mm: [f64; 2],
    /// Side along x; never shorter than the short side that was drawn.
    pub long_side_mm: [f64; 2],
    /// Height.
    pub height_mm: [f64; 2],
    /// Centre in the robot frame.
    pub x_mm: [f64; 2],
    /// Centre in the robot frame.
    pub y_mm: [f64; 2],
    /// Turn about the vertical.
    pub yaw_deg: [f64; 2],
    /// Does the hand turn with the target, so that its fingers close across the short side at any yaw? Ranges of `ψ` then count
    /// from the target's yaw.
    pub hand_follows_yaw: bool,
}

/// What the obstacles are and where they stand; `[from, to]` are drawn evenly.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObstacleConfig {
    /// How many.
    pub count: [u32; 2],
    /// Shapes, equally often.
    pub shapes: Vec<ShapeName>,
    /// As for targets.
    pub short_side_mm: [f64; 2],
    /// As for targets.
    pub long_side_mm: [f64; 2],
    /// Height.
    pub height_mm: [f64; 2],
    /// Turn about the vertical.
    pub yaw_deg: [f64; 2],
    /// Horizontal distance of the centre from the hand: of an approach, at its goal.
    pub distance_mm: [f64; 2],
    /// Least free space to the target and to each other.
    pub gap_mm: f64,
}

impl TargetConfig {
    /// Refuses values that make no target; names the key.
    pub fn validate(&self) -> Result<()> {
        let sides = [self.short_side_mm, self.long_side_mm, self.height_mm];
        validate_sides("target", &self.shapes, sides)?;
        require_interval(
            "target.x_mm",
            self.x_mm,
            [-2000.0, 2000.0],
            "[from, to], within 2000 of the robot",
        )?;
        require_interval(
            "target.y_mm",
            self.y_mm,
            [-2000.0, 2000.0],
            "[from, to], within 2000 of the robot",
        )?;
        require_interval("target.yaw_deg", self.yaw_deg, [-180.0, 180.0], "[from, to], within -180 to 180")
    }
}

impl ObstacleConfig {
    /// Refuses values that make no obstacles; names the key.
    pub fn validate(&self) -> Result<()> {
        let [from, to] = self.count;
        require(
            "obstacles.count",
            from <= to && to <= 100,
            format!("{:?}", self.count),
            "[from, to], at most 100",
        )?;
        let sides = [self.short_side_mm, self.long_side_mm, self.height_mm];
        validate_sides("obstacles", &self.shapes, sides)?;
        require_interval(
            "obstacles.yaw_deg",
            self.yaw_deg,
            [-180.0, 180.0],
            "[from, to], within -180 to 180",
        )?;
        require_interval(
            "obstacles.distance_mm",
            self.distance_mm,
            [0.0, 2000.0],
            "[from, to], within 0 to 2000",
        )?;
        require("obstacles.gap_mm", (0.0..=1000.0).contains(&self.gap_mm), self.gap_mm, "0 to 1000")
    }
}

fn validate_sides(table: &str, shapes: &[ShapeName], sides: [[f64; 2]; 3]) -> Result<()> {
    require(format!("{table}.shapes"), !shapes.is_empty(), "[]", "at least one shape")?;
    for (name, side) in ["short_side_mm", "long_side_mm", "height_mm"].into_iter().zip(sides) {
        require_interval(format!("{table}.{name}"), side, [1.0, 1000.0], "[from, to], within 1 to 1000")?;
    }
    let [short, long, _] = sides;
    let expected = "a longest side that is at least the longest short side";
    require(format!("{table}.long_side_mm"), long[1] >= short[1], format!("{long:?}"), expected)
}
