//! Servo sessions, and the tables and figures made of them (paper, Sections 4.3, 5 and 6.4).
//!
//! One step of a session is the paper's Figure 2:
//!
//! ```text
//! current image ─┬─▶ approach policy ──▶ v_g ─┐
//! goal image ────┘                            ├─▶ deflect ──▶ v̂_g ──▶ mediate ──▶ q ──▶ arm ──▶ current image
//! current image ───▶ avoid policy ────▶ G ────┘
//! ```
//!
//! Reading order: [`session`], [`policy`], [`deflect`], [`mediate`] with its rows [`joint_limits`] and [`field_of_view`],
//! [`trial`], [`trace`]. Then what is made of the records: [`accuracy`], [`conduct`], [`tables`] for people and [`measures`]
//! for programs, [`figures`], [`report`].

#![forbid(unsafe_code)]

pub mod accuracy;
pub mod conduct;
pub mod config;
pub mod deflect;
pub mod error;
pub mod field_of_view;
pub mod figures;
#[cfg(test)]
mod fixture;
pub mod grid;
pub mod joint_limits;
mod learned;
pub mod measures;
pub mod mediate;
pub mod oracle;
pub mod paper;
pub mod plot;
pub mod policy;
pub mod report;
pub mod session;
pub mod stop;
pub mod svg;
pub mod tables;
pub mod trace;
pub mod trial;

pub use config::EvalConfig;
pub use error::{Error, Result};
pub use policy::{ApproachPolicy, AvoidPolicy, Policies};
pub use session::{Session, run_sessions};
pub use trace::{Outcome, SessionRecord, Step};
