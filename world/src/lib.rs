//! The virtual environment: what stands on the table, what the wrist camera sees of it, and the arm that moves the camera.
//!
//! Training data and servo sessions both come from here; that is the paper's claim made into a crate. It reads no file and
//! no clock, knows no network, and is deterministic. Metres, radians and `f64` throughout.
//!
//! Frames (right-handed), and transforms named `a_from_b`:
//!
//! ```text
//! robot    HIRO's WAIST: x forward, y left, z up. The table is a plane z = const in it.
//! hand     palm centre: z along the approach direction. For a hand that looks straight down without yaw,
//!          x is the robot's x (forward), y its -y (right), z its -z (down).
//! camera   x right, y down, z forward (into the scene). It sits behind the hand and looks along its z;
//!          the image's upper edge is on the hand's x side.
//! body     centre of a body, z along its height.
//! ```
//!
//! Reading order: [`scene`], [`camera`], [`render`], [`arm`], [`avoidance`].

#![forbid(unsafe_code)]

pub mod arm;
pub mod avoidance;
pub mod camera;
pub mod config;
mod coverage;
pub mod environment;
pub mod error;
pub mod geometry;
pub mod hand;
mod hash;
pub mod hiro;
mod ik;
pub mod measuring_points;
pub mod pose;
pub mod render;
mod scan;
pub mod scene;
pub mod sensor;
pub mod shape;
mod silhouette;
mod surface;
pub mod texture;
pub mod units;
mod view;

pub use arm::{Arm, JointLimits, JointVector};
pub use avoidance::{AvoidanceMap, ObstacleElements};
pub use camera::Camera;
pub use config::WorldConfig;
pub use environment::Environment;
pub use error::{Error, Result};
pub use hand::{Contacts, Hand};
pub use measuring_points::MeasuringPoints;
pub use pose::{LabelForm, PoseChange};
pub use render::{Frame, Renderer};
pub use scene::{Body, Light, Material, Scene, Table};
pub use sensor::Sensor;
pub use shape::Shape;
pub use texture::Texture;
