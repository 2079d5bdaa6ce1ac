//! A scene: a table with a target and obstacles on it (paper, Sections 3.1 and 6.1). A description that knows no renderer.

use crate::config::{LightConfig, TableConfig};
use crate::shape::Shape;
use crate::texture::Texture;
use crate::units::mm;
use nalgebra::{Isometry3, Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

/// Red, green and blue in `[0, 1]`, as images store them: light adds up linearly and no gamma is applied.
pub type Color = [f64; 3];

/// How a body looks.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Color of the body.
    pub color: Color,
    /// A cross on the upper side, if any.
    pub cross: Option<Cross>,
    /// The body's pattern, if any; the cross is painted on thinly and has it too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texture: Option<Texture>,
}

/// The cross on top of the target: every point of the upper side with `|x|` or `|y|` below half the bar's width.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cross {
    /// Color of the bars.
    pub color: Color,
    /// Width of a bar \[m\].
    pub width: f64,
}

/// A primitive somewhere in the robot's space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Body {
    /// Its shape.
    pub shape: Shape,
    /// Its pose.
    pub robot_from_body: Isometry3<f64>,
    /// Its look.
    pub material: Material,
}

/// The table: a horizontal rectangle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// Centre of the table top in the robot frame \[m\].
    pub center: Point3<f64>,
    /// Half of its sides along the robot's x and y \[m\].
    pub half_size: [f64; 2],
    /// Its color.
    pub color: Color,
    /// Its pattern, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texture: Option<Texture>,
}

impl Table {
    /// From the configuration.
    pub fn new(config: &TableConfig) -> Self {
        let [x, y, z] = config.center_mm.map(mm);
        Self {
            center: Point3::new(x, y, z),
            half_size: config.size_mm.map(|s| mm(s) / 2.0),
            color: config.color,
            texture: None,
        }
    }

    /// Height of its surface in the robot frame \[m\].
    pub fn height(&self) -> f64 {
        self.center.z
    }
}

/// Light from infinitely far away; a face with unit normal `n` shows its color times
/// `ambient + (1 - ambient) max(0, n · towards_light)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Light {
    /// Direction towards the light, in the robot frame.
    pub towards_light: Unit<Vector3<f64>>,
    /// Share of the light that comes from everywhere, in `[0, 1]`.
    pub ambient: f64,
}

impl Light {
    /// From the configuration.
    pub fn new(config: &LightConfig) -> Self {
        Self { towards_light: Unit::new_normalize(config.towards_light.into()), ambient: config.ambient }
    }

    /// Brightness of a face, in `[0, 1]`.
    pub fn on(&self, normal: &Vector3<f64>) -> f64 {
        self.ambient + (1.0 - self.ambient) * normal.dot(&self.towards_light).max(0.0)
    }
}

/// What stands on the table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// The table.
    pub table: Table,
    /// The object to be grasped.
    pub target: Body,
    /// What is in the way.
    pub obstacles: Vec<Body>,
    /// The light.
    pub light: Light,
    /// Color where a ray meets nothing.
    pub background: Color,
}

impl Scene {
    /// Target first, then the obstacles: the order of instance numbers (1, 2, …) in a rendered frame.
    pub fn bodies(&self) -> impl Iterator<Item = &Body> {
        std::iter::once(&self.target).chain(&self.obstacles)
    }

    /// Centre of the target in the robot frame: the point that the field-of-view rows keep in sight.
    pub fn target_center(&self) -> Point3<f64> {
        self.target.robot_from_body.translation.vector.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_written_before_there_were_textures_is_read_and_none_is_not_written() {
        let plain = "color = [0.5, 0.25, 1.0]\n";
        let material: Material = toml::from_str(plain).unwrap();
        assert_eq!(material, Material { color: [0.5, 0.25, 1.0], cross: None, texture: None });
        assert_eq!(toml::to_string(&material).unwrap(), plain);
        let texture = Texture { grain: Vector3::new(0.05, 0.002, 0.01), contrast: 0.3, seed: 7 };
        let dyed = Material { texture: Some(texture), ..material };
        assert_eq!(toml::from_str::<Material>(&toml::to_string(&dyed).unwrap()).unwrap(), dyed);
    }
}
