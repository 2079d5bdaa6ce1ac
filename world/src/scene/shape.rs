//! The primitive shapes of objects (paper, Section 3.1).

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// A convex primitive, centered at the origin of its body frame, with its height along z.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shape {
    /// A box.
    Cuboid {
        /// Half of the sides along x, y and z \[m\].
        half_extents: Vector3<f64>,
    },
    /// A cylinder about the z axis. (In parry it is the y axis; `geometry` converts.)
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
    /// Returns half of the sides of the bounding box with the axes of the body \[m\].
    pub fn half_extents(&self) -> Vector3<f64> {
        match *self {
            Self::Cuboid { half_extents } => half_extents,
            Self::Cylinder { radius, half_height } => Vector3::new(radius, radius, half_height),
            Self::Sphere { radius } => Vector3::repeat(radius),
        }
    }

    /// Returns the name of the shape, as stored in datasets.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Cuboid { .. } => "cuboid",
            Self::Cylinder { .. } => "cylinder",
            Self::Sphere { .. } => "sphere",
        }
    }
}
