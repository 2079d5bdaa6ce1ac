//! The virtual environment: the scene on the table, the wrist camera that sees it, and the arm that moves the camera.
//!
//! Training data and servo sessions both come from this environment; that is the idea of the paper. The crate is deterministic:
//! it reads no files and no clock. It contains no neural network. All quantities are `f64`, in meters and radians.
//!
//! Frames are right-handed, and transforms are named `a_from_b`:
//!
//! ```text
//! robot    HIRO's WAIST: x forward, y left, z up. The table is a plane z = const in this frame.
//! hand     Center of the palm, z along the approach direction. When the hand looks straight down without yaw,
//!          x is the robot's x (forward), y its -y (right), z its -z (down).
//! camera   x right, y down, z forward (into the scene). The camera is behind the hand and looks along the hand's z axis;
//!          the upper edge of the image is on the side of the hand's x axis.
//! body     Center of a body, z along its height.
//! ```
//!
//! Reading order: [`scene`], [`camera`], [`render`], [`arm`], [`avoidance`], and [`environment`], which combines them.

#![forbid(unsafe_code)]

pub mod arm;
pub mod avoidance;
pub mod camera;
mod color;
pub mod config;
pub mod environment;
pub mod error;
#[cfg(test)]
mod fixture;
pub mod geometry;
mod hash;
pub mod pose;
pub mod render;
pub mod scene;
pub mod units;

pub use arm::{Arm, Contacts, Hand, JointLimits, JointVector, hiro};
pub use avoidance::{AvoidanceMap, MeasuringPoints, ObstacleElements};
pub use camera::{Camera, Sensor};
pub use config::WorldConfig;
pub use environment::Environment;
pub use error::{Error, Result};
pub use pose::{LabelForm, PoseChange};
pub use render::{Frame, Renderer};
pub use scene::{Body, Light, Material, Scene, Shape, Table, Texture};
