//! Networks, training loop and checkpoints
#![deny(unsafe_code)]

pub mod batch;
mod camera;
pub mod checkpoint;
pub mod config;
pub mod error;
pub mod examples;
pub mod fit;
mod gradient;
pub mod history;
mod input;
pub mod loss;
pub mod metric;
pub mod model;
pub mod net;
pub mod network;
pub mod normalization;
mod publish;
pub mod schedule;
pub mod split;
mod targets;

pub use checkpoint::{Checkpoint, ModelInfo};
pub use config::{Task, TrainConfig};
pub use error::{Error, Result};
pub use examples::Examples;
pub use fit::{EpochRecord, Fitted, Progress, Run, fit};
pub use model::{ApproachModel, AvoidModel};
