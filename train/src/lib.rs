//! Networks, training loop and checkpoints (paper, Section 4).
//!
//! Datasets become [`examples`], their images decoded once or for every batch; [`fit`](mod@fit) takes the [`network`] of a
//! [`config`] through them and leaves [`checkpoint`]s; a [`model`] reads one and maps images to pose changes or avoidance
//! maps.
//!
//! **Invariant:** weights are a pure function of configuration and data, on the CPU to the bit, no matter how often the
//! run was interrupted.
#![deny(unsafe_code)]

pub mod adamw;
pub mod batch;
mod beginning;
mod cache;
mod camera;
pub mod checkpoint;
pub mod config;
mod curve;
pub mod description;
pub mod error;
pub mod examples;
pub mod fit;
pub mod history;
mod input;
pub mod journal;
pub mod loss;
pub mod memory;
pub mod metric;
pub mod model;
pub mod net;
pub mod network;
pub mod normalization;
mod phase;
mod place;
pub mod pretrained;
mod publish;
pub mod schedule;
pub mod split;
mod stream;
mod targets;
mod tensorboard;
pub mod warm_start;

pub use checkpoint::{Checkpoint, ModelInfo};
pub use config::{Task, TrainConfig};
pub use description::Description;
pub use error::{Error, Result};
pub use examples::Examples;
pub use fit::{Fitted, Progress, Run, fit};
pub use history::EpochRecord;
pub use journal::Gauge;
pub use model::{ApproachModel, AvoidModel};
pub use warm_start::WarmStart;
