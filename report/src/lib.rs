//! Pictures of results: figures of servo sessions, training curves, contact sheets of datasets, and the HTML report.
//!
//! All pictures are SVG without external resources. [`drawing`] holds the parts that they share.

#![forbid(unsafe_code)]

pub mod dataset;
pub mod drawing;
pub mod figures;
#[cfg(test)]
mod fixture;
pub mod page;
pub mod training_curves;
