//! Servo sessions and the results computed from them (paper, Sections 4.3, 5 and 6.4).
//!
//! One step of a session is the paper's Figure 2:
//!
//! ```text
//! current image ─┬─▶ approach policy ──▶ v_g ─┐
//! goal image ────┘                            ├─▶ deflect ──▶ v̂_g ──▶ mediate ──▶ q ──▶ arm ──▶ current image
//! current image ───▶ avoid policy ────▶ G ────┘
//! ```
//!
//! Reading order: [`config`], [`trial`], [`policy`], [`session`] with [`mediate`], [`evaluation`], [`results`].

#![forbid(unsafe_code)]

pub mod config;
pub mod error;
pub mod evaluation;
#[cfg(test)]
mod fixture;
pub mod mediate;
pub mod policy;
pub mod results;
pub mod session;
pub mod trial;

pub use config::EvalConfig;
pub use error::{Error, Result};
pub use evaluation::run_sessions;
pub use policy::{ApproachFactory, ApproachPolicy, AvoidFactory, AvoidPolicy, Policies, View};
pub use session::Session;
pub use session::outcome::Outcome;
pub use session::record::{SessionRecord, Step};
