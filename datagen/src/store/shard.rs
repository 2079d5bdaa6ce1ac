//! The shards of a dataset: names and rows of its Parquet files.

use super::part::Part;
use crate::config::DatasetConfig;
use std::ops::Range;

/// One Parquet file of a dataset.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shard {
    name: String,
    /// Rows of the file.
    pub rows: Range<u64>,
}

impl Shard {
    /// Returns all shards of a dataset. Names and rows depend on the configuration only.
    pub fn all(config: &DatasetConfig) -> Vec<Self> {
        let shards = config.shards();
        (0..shards)
            .map(|i| {
                let start = i * config.rows_per_shard;
                let end = (start + config.rows_per_shard).min(config.count);
                Self { name: format!("train-{i:05}-of-{shards:05}"), rows: start..end }
            })
            .collect()
    }

    /// Returns the shards of a part of a dataset.
    pub fn of_part(config: &DatasetConfig, part: Part) -> Vec<Self> {
        (0..).zip(Self::all(config)).filter(|&(i, _)| part.contains(i)).map(|(_, shard)| shard).collect()
    }

    /// Returns the file name without folder and extension.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the path of the file below the folder of the dataset.
    pub fn path(&self) -> String {
        format!("data/{}.parquet", self.name)
    }

    /// Returns the number of rows.
    pub fn row_count(&self) -> u64 {
        self.rows.end - self.rows.start
    }
}
