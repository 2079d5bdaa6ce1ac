//! Measurements and records of a run: validation metrics, the loss curve, `metrics.jsonl` and TensorBoard's event files.

pub mod history;
pub(crate) mod journal;
pub(crate) mod loss_curve;
pub(crate) mod tensorboard;
pub(crate) mod validation;

pub use self::history::EpochRecord;
pub use self::journal::Telemetry;
pub use self::validation::{ApproachMetrics, AvoidanceMetrics, AxisErrors, Metrics};
