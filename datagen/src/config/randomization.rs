//! What a configuration says of domain randomization. Where every number is 0, nothing is randomized.

use crate::config::{require, require_interval};
use crate::error::Result;
use serde::{Deserialize, Serialize};
use world::Light;
use world::config::LightConfig;
use world::units::to_deg;

/// What differs from example to example, beyond the paper.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RandomizationConfig {
    /// The light.
    pub light: LightSpread,
    /// Colors.
    pub colors: ColorSpread,
    /// Textures.
    pub texture: TextureConfig,
    /// The camera.
    pub camera: CameraSpread,
}

/// How far the light differs from `world.light`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LightSpread {
    /// It comes from anywhere within a cone of this half-angle, evenly by solid angle.
    pub cone_deg: f64,
    /// Its ambient share moves by up to so much either way, within 0 and 1.
    pub ambient: f64,
}

/// By how much each channel of a color moves either way, within 0 and 1.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColorSpread {
    /// Of the table.
    pub table: f64,
    /// Of the target.
    pub target: f64,
    /// Of the cross on the target.
    pub cross: f64,
    /// Of each obstacle by itself.
    pub obstacles: f64,
    /// Of what is beyond the table.
    pub background: f64,
}

/// Textures of the table, and of target and obstacles.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextureConfig {
    /// Of the table.
    pub table: TextureRange,
    /// Of the target and of each obstacle by itself.
    pub objects: TextureRange,
}

/// Textures to draw from, `[from, to]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TextureRange {
    /// How much lighter and darker it makes a surface, as a share of its color; `[0, 0]` is no texture.
    pub contrast: [f64; 2],
    /// Size of its pattern.
    pub grain_mm: [f64; 2],
    /// So many times longer is the pattern along one of the body's axes: 1 is stone, 8 is wood.
    pub stretch: [f64; 2],
}

/// What is wrong with the camera; `[from, to]` are drawn evenly.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSpread {
    /// Standard deviation of its blur, in pixels.
    pub blur: [f64; 2],
    /// Standard deviation of its noise, as a share of full scale.
    pub noise: [f64; 2],
    /// Its mount is off by up to so much along each axis of the camera.
    pub shift_mm: f64,
    /// Its mount is turned by up to so much about each axis of the camera.
    pub turn_deg: f64,
}

impl RandomizationConfig {
    /// Refuses values that make no picture; names the key.
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
        require_interval(format!("{key}.contrast"), self.contrast, [0.0, 1.0], "[from, to], within 0 to 1")?;
        require_interval(
            format!("{key}.grain_mm"),
            self.grain_mm,
            [0.1, 1000.0],
            "[from, to], within 0.1 to 1000",
        )?;
        require_interval(format!("{key}.stretch"), self.stretch, [1.0, 100.0], "[from, to], within 1 to 100")
    }
}

impl CameraSpread {
    fn validate(&self) -> Result<()> {
        let key = |name| format!("randomization.camera.{name}");
        require_interval(key("blur"), self.blur, [0.0, 20.0], "[from, to], within 0 to 20 pixels")?;
        require_interval(key("noise"), self.noise, [0.0, 0.5], "[from, to], within 0 to 0.5")?;
        require(key("shift_mm"), (0.0..=100.0).contains(&self.shift_mm), self.shift_mm, "0 to 100")?;
        require(key("turn_deg"), (0.0..=30.0).contains(&self.turn_deg), self.turn_deg, "0 to 30")
    }
}
