//! The light.

use crate::config::LightConfig;
use nalgebra::{Unit, Vector3};
use serde::{Deserialize, Serialize};

/// Distant light. A face with unit normal `n` shows its color multiplied by
/// `ambient + (1 - ambient) max(0, n · towards_light)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Light {
    /// Direction toward the light in the robot frame.
    pub towards_light: Unit<Vector3<f64>>,
    /// Fraction of ambient light, in `[0, 1]`.
    pub ambient: f64,
}

impl Light {
    /// Creates the light that a configuration describes.
    pub fn new(config: &LightConfig) -> Self {
        Self { towards_light: Unit::new_normalize(config.towards_light.into()), ambient: config.ambient }
    }

    /// Returns the brightness of a face with this unit normal, in `[0, 1]`.
    pub fn on(&self, normal: &Vector3<f64>) -> f64 {
        self.ambient + (1.0 - self.ambient) * normal.dot(&self.towards_light).max(0.0)
    }
}
