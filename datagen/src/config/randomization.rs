//! Domain randomization. With all numbers 0, nothing is randomized.

use super::validation::{Result, require, require_interval};
use serde::{Deserialize, Serialize};
use world::Light;
use world::config::LightConfig;
use world::units::to_deg;

/// Variation between examples, beyond the paper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RandomizationConfig {
    /// Direction and strength of the light.
    pub light: LightSpread,
    /// Colors of all surfaces.
    pub colors: ColorSpread,
    /// Textures of all surfaces.
    pub texture: TextureConfig,
    /// Camera mount and sensor.
    pub camera: CameraSpread,
}

/// Deviation of the light from `world.light`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightSpread {
    /// Half-angle of the cone of directions, drawn uniformly by solid angle.
    pub cone_deg: f64,
    /// Maximum change of the ambient fraction in either direction; the result is clamped to 0 to 1.
    pub ambient: f64,
}

/// Maximum change of each color channel in either direction; the result is clamped to 0 to 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColorSpread {
    /// Table.
    pub table: f64,
    /// Target.
    pub target: f64,
    /// Cross on the target.
    pub cross: f64,
    /// Obstacles, each drawn independently.
    pub obstacles: f64,
    /// Background beyond the table.
    pub background: f64,
}

/// Textures of the table and of the objects on it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextureConfig {
    /// Table.
    pub table: TextureRange,
    /// Target and obstacles, each drawn independently.
    pub objects: TextureRange,
}

/// Range of textures. Values are drawn uniformly from `[from, to]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextureRange {
    /// Contrast, as a fraction of the color of the surface; `[0, 0]` means no texture.
    pub contrast: [f64; 2],
    /// Size of the pattern.
    pub grain_mm: [f64; 2],
    /// Elongation of the pattern along one axis of the body: 1 resembles stone, 8 resembles wood.
    pub stretch: [f64; 2],
}

/// Imperfections of the camera. Values are drawn uniformly from `[from, to]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSpread {
    /// Standard deviation of the blur, in pixels.
    pub blur: [f64; 2],
    /// Standard deviation of the noise, as a fraction of full scale.
    pub noise: [f64; 2],
    /// Maximum offset of the mount along each axis of the camera.
    pub shift_mm: f64,
    /// Maximum rotation of the mount about each axis of the camera.
    pub turn_deg: f64,
}

impl RandomizationConfig {
    /// Checks every value; an error names the key.
    pub fn validate(&self, light: &LightConfig) -> Result<()> {
        let LightSpread { cone_deg, ambient } = self.light;
        let up = Light::new(light).towards_light.z;
        let elevation = to_deg(libm::asin(up));
        let expected = "0, or an angle that keeps the light of world.light.towards_light above the table";
        require(
            "randomization.light.cone_deg",
            cone_deg == 0.0 || (0.0..elevation).contains(&cone_deg),
            cone_deg,
            expected,
        )?;
        let ColorSpread { table, target, cross, obstacles, background } = self.colors;
        for (key, value) in [
            ("light.ambient", ambient),
            ("colors.table", table),
            ("colors.target", target),
            ("colors.cross", cross),
            ("colors.obstacles", obstacles),
            ("colors.background", background),
        ] {
            require(format!("randomization.{key}"), (0.0..=1.0).contains(&value), value, "0 to 1")?;
        }
        self.texture.table.validate("randomization.texture.table")?;
        self.texture.objects.validate("randomization.texture.objects")?;
        self.camera.validate()
    }
}

impl TextureRange {
    fn validate(&self, key: &str) -> Result<()> {
        require_interval(
            format!("{key}.contrast"),
            self.contrast,
            [0.0, 1.0],
            "[from, to], between 0 and 1",
        )?;
        require_interval(
            format!("{key}.grain_mm"),
            self.grain_mm,
            [0.1, 1000.0],
            "[from, to], between 0.1 and 1000",
        )?;
        require_interval(
            format!("{key}.stretch"),
            self.stretch,
            [1.0, 100.0],
            "[from, to], between 1 and 100",
        )
    }
}

impl CameraSpread {
    fn validate(&self) -> Result<()> {
        let key = |name| format!("randomization.camera.{name}");
        require_interval(key("blur"), self.blur, [0.0, 20.0], "[from, to], between 0 and 20 pixels")?;
        require_interval(key("noise"), self.noise, [0.0, 0.5], "[from, to], between 0 and 0.5")?;
        require(key("shift_mm"), (0.0..=100.0).contains(&self.shift_mm), self.shift_mm, "0 to 100")?;
        require(key("turn_deg"), (0.0..=30.0).contains(&self.turn_deg), self.turn_deg, "0 to 30")
    }
}
