//! A scene: a table with a target and obstacles on it (paper, Sections 3.1 and 6.1). These types only describe it.

mod body;
mod gradient_noise;
mod light;
mod shape;
mod table;
mod texture;

pub use crate::color::Color;
pub use body::{Body, Cross, Material};
pub(crate) use gradient_noise::GradientNoise;
pub use light::Light;
pub use shape::Shape;
pub use table::Table;
pub use texture::Texture;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

/// A table, the target and obstacles on it, and the light.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Scene {
    /// Table.
    pub table: Table,
    /// Object to grasp.
    pub target: Body,
    /// Other objects, to be avoided.
    pub obstacles: Vec<Body>,
    /// Light.
    pub light: Light,
    /// Color where a ray hits nothing.
    pub background: Color,
}

impl Scene {
    /// Iterates over the target and then the obstacles: the order of instance numbers (1, 2, …) in a rendered frame.
    pub fn bodies(&self) -> impl Iterator<Item = &Body> {
        std::iter::once(&self.target).chain(&self.obstacles)
    }

    /// Returns the center of the target in the robot frame: the point that the field-of-view constraint keeps in view.
    pub fn target_center(&self) -> Point3<f64> {
        self.target.robot_from_body.translation.vector.into()
    }
}
