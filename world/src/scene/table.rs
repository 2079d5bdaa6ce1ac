//! The table.

use crate::color::Color;
use crate::config::TableConfig;
use crate::scene::texture::Texture;
use crate::units::mm;
use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// The table top: a horizontal rectangle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// Center in the robot frame \[m\].
    pub center: Point3<f64>,
    /// Half of the sides along the robot's x and y axes \[m\].
    pub half_size: [f64; 2],
    /// Color.
    pub color: Color,
    /// Texture, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texture: Option<Texture>,
}

impl Table {
    /// Creates the table that a configuration describes, without a texture.
    pub fn new(config: &TableConfig) -> Self {
        let [x, y, z] = config.center_mm.map(mm);
        Self {
            center: Point3::new(x, y, z),
            half_size: config.size_mm.map(|s| mm(s) / 2.0),
            color: config.color,
            texture: None,
        }
    }

    /// Returns the height of the surface in the robot frame \[m\].
    pub fn height(&self) -> f64 {
        self.center.z
    }
}
