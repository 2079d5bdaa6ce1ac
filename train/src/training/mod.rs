//! Training runs. [`fit`](fit()) starts or resumes a [`Run`] and repeats: batch, loss, gradients, optimizer step; after each
//! epoch it validates and saves a checkpoint.

pub(crate) mod epoch;
pub(crate) mod event;
pub(crate) mod fit;
pub(crate) mod learner;
pub(crate) mod run;
pub(crate) mod start;

pub use self::event::Event;
pub use self::fit::{RunSummary, fit};
pub use self::run::{Run, can_resume};
