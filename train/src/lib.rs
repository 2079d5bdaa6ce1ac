//! Networks, training loop and checkpoints (paper, Section 4).
//!
//! In the order in which data passes through: [`data`] turns datasets into batches, a [`network`] maps images to outputs,
//! the [`optimizer`] turns the loss into a step, [`training`] repeats this as the [`config`] says, [`metrics`] records how it
//! goes, and a [`checkpoint`] holds the result, which an [`ApproachModel`] or an [`AvoidModel`] uses.
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
