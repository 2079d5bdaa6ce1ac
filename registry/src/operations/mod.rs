//! What users do with a registry.

mod copy;
pub(crate) mod diff;
pub(crate) mod gc;
mod publish;
pub(crate) mod pull;
mod resolve;
mod verify;

pub use copy::Copied;
pub use diff::{Change, Difference, MetricChange};
pub use gc::{GRACE, Garbage};
pub use resolve::Model;
pub use verify::Verification;
