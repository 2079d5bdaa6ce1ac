//! The primitive shapes that objects are made of (paper, Section 3.1).

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// A convex primitive, centred at the origin of its body frame, its height along z.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shape {
    /// A box.
    Cuboid {
        /// Half of the sides along x, y and z \[m\].
        half_extents: Vector3<f64>,
    },
    /// An upright cylinder; its axis is z (parry's is y: `geometry` turns it).
    Cylinder {
        /// Radius \[m\].
        radius: f64,
        /// Half of the height \[m\].
        half_height: f64,
    },
    /// A sphere.
    Sphere {
        /// Radius \[m\].
        radius: f64,
    },
}

impl Shape {
    /// Half of the sides of the smallest enclosing box with the body's axes \[m\].
    pub fn half_extents(&self) -> Vector3<f64> {
        match *self {
            Self::Cuboid { half_extents } => half_extents,
            Self::Cylinder { radius, half_height } => Vector3::new(radius, radius, half_height),
            Self::Sphere { radius } => Vector3::repeat(radius),
        }
    }

    /// The shape's name, as in datasets.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Cuboid { .. } => "cuboid",
            Self::Cylinder { .. } => "cylinder",
            Self::Sphere { .. } => "sphere",
        }
    }
}
