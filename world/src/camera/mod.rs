//! The wrist camera: a pinhole, and the imperfections of a real sensor.

mod pinhole;
mod sensor;

pub use pinhole::Camera;
pub use sensor::Sensor;
