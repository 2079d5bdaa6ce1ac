//! Results of an evaluation, beside the paper's: statistics of the records, tables for people, and metrics for programs.

pub mod accuracy;
pub mod distribution;
pub mod metrics;
pub mod outcomes;
mod pose_variable;
pub mod published;
pub mod system;
pub mod table;
pub mod table_1;
