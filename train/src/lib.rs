//! Networks, training loop and checkpoints (paper, Section 4).
//!
//! Data passes through the modules in this order: [`data`] turns datasets into batches, a [`network`] maps images to
//! outputs, and the [`optimizer`] turns the loss into a step. [`training`] repeats this according to the [`config`], and
//! [`metrics`] records the progress. A [`checkpoint`] stores the result for an [`ApproachModel`] or an [`AvoidModel`].
//!
//! **Invariant:** weights are a pure function of configuration and data, bit-identical on the CPU, however often the run
//! was interrupted.
#![deny(unsafe_code)]

pub mod checkpoint;
pub mod config;
pub mod data;
mod difference;
pub mod error;
pub mod memory;
pub mod metrics;
pub mod network;
pub mod optimizer;
pub mod training;

pub use checkpoint::{ApproachModel, AvoidModel, Checkpoint, Description, ModelInfo, WarmStart};
pub use config::TrainConfig;
pub use data::Examples;
pub use error::{Error, Result};
pub use metrics::{EpochRecord, Metrics, Telemetry};
pub use network::Task;
pub use training::{Event, Run, RunSummary, can_resume, fit};
