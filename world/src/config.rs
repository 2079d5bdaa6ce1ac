//! Configuration of the virtual environment, as in `configs/world.toml`.

use crate::color::Color;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Configuration of the virtual environment, without the objects on the table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorldConfig {
    /// Wrist camera.
    pub camera: CameraConfig,
    /// Table.
    pub table: TableConfig,
    /// Light.
    pub light: LightConfig,
    /// Colors of the objects and the background.
    pub colors: ColorConfig,
    /// Arm.
    pub arm: ArmConfig,
    /// Solid parts of the hand.
    pub hand: HandConfig,
    /// Ground truth of `CNN_avoid`.
    pub avoidance: AvoidanceConfig,
}

/// A pinhole camera behind the hand that looks along the approach direction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// Horizontal field of view.
    pub horizontal_fov_deg: f64,
    /// Distance from the camera to the hand frame along the approach direction.
    pub behind_hand_mm: f64,
}

/// The table top, a horizontal rectangle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableConfig {
    /// Center of the surface in the robot frame.
    pub center_mm: [f64; 3],
    /// Sides along the robot's x and y axes.
    pub size_mm: [f64; 2],
    /// Color.
    pub color: Color,
}

/// A distant light.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightConfig {
    /// Direction toward the light in the robot frame, as a vector of any length.
    pub towards_light: [f64; 3],
    /// Fraction of ambient light.
    pub ambient: f64,
}

/// Colors, linear, in `[0, 1]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColorConfig {
    /// The target (paper: white).
    pub target: Color,
    /// The cross on top of the target (paper: red).
    pub cross: Color,
    /// Width of the bars of the cross, as a fraction of the shorter side of the target.
    pub cross_width: f64,
    /// Obstacles (paper: gray).
    pub obstacle: Color,
    /// Background.
    pub background: Color,
}

/// Parameters of HIRO's left arm that its published descriptions leave open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmConfig {
    /// Offset of the last joint along x: -47 (current CAD data) or -40 (older model).
    pub last_offset_mm: f64,
    /// Angle of the chest joint, which is fixed.
    pub chest_deg: f64,
}

/// The boxes of the hand, along the axes of the hand frame. They are used for collisions and reference points.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HandConfig {
    /// Sides of the palm. Its front face is the plane z = 0 of the hand frame.
    pub palm_mm: [f64; 3],
    /// Sides of a finger: along x, along y, and its length along z from the palm to the fingertip.
    pub finger_mm: [f64; 3],
    /// Free space between the open fingers along y.
    pub opening_mm: f64,
}

/// Parameters of the avoidance map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AvoidanceConfig {
    /// Number of measuring points, N.
    pub measuring_points: usize,
    /// Side of an obstacle element.
    pub element_mm: f64,
}

impl WorldConfig {
    /// Checks all values. An error names the key.
    pub fn validate(&self) -> Result<()> {
        let CameraConfig { width, height, horizontal_fov_deg: fov, behind_hand_mm: behind } = self.camera;
        require("camera.width", (8..=8192).contains(&width), &width, "8 to 8192 pixels")?;
        require("camera.height", (8..=8192).contains(&height), &height, "8 to 8192 pixels")?;
        require(
            "camera.horizontal_fov_deg",
            fov > 1.0 && fov < 170.0,
            &fov,
            "more than 1 and less than 170",
        )?;
        require("camera.behind_hand_mm", (0.0..=1000.0).contains(&behind), &behind, "0 to 1000")?;
        for (key, side) in ["table.size_mm[0]", "table.size_mm[1]"].into_iter().zip(self.table.size_mm) {
            require(key, side > 0.0, &side, "more than 0")?;
        }
        let light = self.light.towards_light;
        let above = light.iter().all(|c| c.is_finite()) && light[2] > 0.0;
        require("light.towards_light", above, &format!("{light:?}"), "a direction with positive z")?;
        require("light.ambient", (0.0..=1.0).contains(&self.light.ambient), &self.light.ambient, "0 to 1")?;
        self.validate_colors()?;
        let cross = self.colors.cross_width;
        require("colors.cross_width", cross > 0.0 && cross < 1.0, &cross, "more than 0 and less than 1")?;
        let [_, palm_y, palm_z] = self.hand.palm_mm;
        let [_, finger_y, finger_z] = self.hand.finger_mm;
        let sides = self.hand.palm_mm.into_iter().chain(self.hand.finger_mm);
        for side in sides {
            require("hand.palm_mm, hand.finger_mm", side > 0.0, &side, "positive sides")?;
        }
        require("hand.palm_mm", palm_z < 500.0 && finger_z < 500.0, &palm_z, "parts shorter than 500 mm")?;
        let reach = self.hand.opening_mm + 2.0 * finger_y;
        let fits = self.hand.opening_mm > 0.0 && reach <= palm_y + 1e-9;
        require("hand.opening_mm", fits, &self.hand.opening_mm, "fingers that fit on the palm")?;
        let points = self.avoidance.measuring_points;
        require("avoidance.measuring_points", (8..=10_000).contains(&points), &points, "8 to 10000")?;
        let element = self.avoidance.element_mm;
        require("avoidance.element_mm", (1.0..=100.0).contains(&element), &element, "1 to 100")
    }

    fn validate_colors(&self) -> Result<()> {
        let ColorConfig { target, cross, obstacle, background, .. } = self.colors;
        let named = [
            ("table.color", self.table.color),
            ("colors.target", target),
            ("colors.cross", cross),
            ("colors.obstacle", obstacle),
            ("colors.background", background),
        ];
        for (key, color) in named {
            let valid = color.iter().all(|c| (0.0..=1.0).contains(c));
            require(key, valid, &format!("{color:?}"), "three numbers from 0 to 1")?;
        }
        Ok(())
    }
}

fn require(key: &'static str, holds: bool, value: &impl ToString, expected: &'static str) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::Config { key, value: value.to_string(), expected }) }
}
