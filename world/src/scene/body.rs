//! Bodies: a shape, a pose and a material.

use crate::color::Color;
use crate::scene::shape::Shape;
use crate::scene::texture::Texture;
use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

/// Appearance of a body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Color of the body.
    pub color: Color,
    /// Cross on the upper side, if any.
    pub cross: Option<Cross>,
    /// Texture, if any. It covers the cross as well.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texture: Option<Texture>,
}

/// Cross on top of the target: all points of the upper side with `|x|` or `|y|` less than half the width of a bar.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Cross {
    /// Color of the bars.
    pub color: Color,
    /// Width of a bar \[m\].
    pub width: f64,
}

/// A primitive solid in the robot frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Body {
    /// Shape.
    pub shape: Shape,
    /// Pose.
    pub robot_from_body: Isometry3<f64>,
    /// Appearance.
    pub material: Material,
}

impl Body {
    /// Returns the height of the lowest corner of the bounding box (with the axes of the body) in the robot frame \[m\].
    pub fn lowest(&self) -> f64 {
        let up = self.robot_from_body.rotation.inverse_transform_vector(&Vector3::z());
        self.robot_from_body.translation.z - up.abs().dot(&self.shape.half_extents())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_material_written_before_there_were_textures_can_be_read() {
        let plain = "color = [0.5, 0.25, 1.0]\n";
        let material: Material = toml::from_str(plain).unwrap();
        assert_eq!(material, Material { color: [0.5, 0.25, 1.0], cross: None, texture: None });
        assert_eq!(toml::to_string(&material).unwrap(), plain);
        let texture = Texture { grain: Vector3::new(0.05, 0.002, 0.01), contrast: 0.3, seed: 7 };
        let dyed = Material { texture: Some(texture), ..material };
        assert_eq!(toml::from_str::<Material>(&toml::to_string(&dyed).unwrap()).unwrap(), dyed);
    }
}
