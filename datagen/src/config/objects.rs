//! Objects on the table: the target and the obstacles.

use super::validation::{Result, require, require_interval};
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

/// Shape, size and position of the target. Values are drawn uniformly from `[from, to]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TargetConfig {
    /// Shapes, equally likely.
    pub shapes: Vec<ShapeName>,
    /// Side along y, across which the fingers close.
    pub short_side_mm: [f64; 2],
    /// Side along x; at least as long as the short side.
    pub long_side_mm: [f64; 2],
    /// Height.
    pub height_mm: [f64; 2],
    /// x of the center in the robot frame.
    pub x_mm: [f64; 2],
    /// y of the center in the robot frame.
    pub y_mm: [f64; 2],
    /// Rotation about the vertical axis.
    pub yaw_deg: [f64; 2],
    /// Whether the hand turns with the target, so that its fingers close across the short side at any yaw. Ranges of `ψ`
    /// are then relative to the yaw of the target.
    pub hand_follows_yaw: bool,
}

/// Number, shapes, sizes and positions of the obstacles. Values are drawn uniformly from `[from, to]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObstacleConfig {
    /// Number of obstacles.
    pub count: [u32; 2],
    /// Shapes, equally likely.
    pub shapes: Vec<ShapeName>,
    /// Side along y, as for the target.
    pub short_side_mm: [f64; 2],
    /// Side along x, as for the target.
    pub long_side_mm: [f64; 2],
    /// Height.
    pub height_mm: [f64; 2],
    /// Rotation about the vertical axis.
    pub yaw_deg: [f64; 2],
    /// Horizontal distance from the hand to the center of an obstacle; for an approach, from the hand at its goal.
    pub distance_mm: [f64; 2],
    /// Minimum gap to the target and between obstacles.
    pub gap_mm: f64,
}

impl TargetConfig {
    /// Checks every value; an error names the key.
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
        require_interval("target.yaw_deg", self.yaw_deg, [-180.0, 180.0], "[from, to], between -180 and 180")
    }
}

impl ObstacleConfig {
    /// Checks every value; an error names the key.
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
            "[from, to], between -180 and 180",
        )?;
        require_interval(
            "obstacles.distance_mm",
            self.distance_mm,
            [0.0, 2000.0],
            "[from, to], between 0 and 2000",
        )?;
        require("obstacles.gap_mm", (0.0..=1000.0).contains(&self.gap_mm), self.gap_mm, "0 to 1000")
    }
}

fn validate_sides(table: &str, shapes: &[ShapeName], sides: [[f64; 2]; 3]) -> Result<()> {
    require(format!("{table}.shapes"), !shapes.is_empty(), "[]", "at least one shape")?;
    for (name, side) in ["short_side_mm", "long_side_mm", "height_mm"].into_iter().zip(sides) {
        require_interval(format!("{table}.{name}"), side, [1.0, 1000.0], "[from, to], between 1 and 1000")?;
    }
    let [short, long, _] = sides;
    let expected = "a maximum no smaller than that of short_side_mm";
    require(format!("{table}.long_side_mm"), long[1] >= short[1], format!("{long:?}"), expected)
}
