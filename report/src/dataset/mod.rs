//! Pictures of a dataset.

pub mod contact_sheet;
mod flow;
pub mod selection;
