//! Reading datasets: rows in any order, statistics, and the comparison of a stored row with a newly generated one.

mod data_file;
mod difference;
mod label_row;
mod reader;
mod replay;
mod running_stats;
pub mod statistics;
mod tally;

pub use difference::Difference;
pub use reader::{DatasetReader, Rows};
pub use replay::{Comparison, ImagePair, Replay, replay};
pub use running_stats::{SummaryStats, percentile};
pub use statistics::DatasetStatistics;
