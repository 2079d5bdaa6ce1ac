//! Small datasets for tests: shipped configurations with a tiny camera and few rows.

use crate::config::DatasetConfig;
use crate::error::Result;
use crate::store::{Options, Summary, generate};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use toml::Table;

/// Returns a file in `configs/datasets` with `extends` resolved.
pub(crate) fn table(name: &str) -> Table {
    let text = match name {
        "a" => include_str!("../../configs/datasets/a.toml"),
        "b" => include_str!("../../configs/datasets/b.toml"),
        "c" => include_str!("../../configs/datasets/c.toml"),
        "avoid" => include_str!("../../configs/datasets/avoid.toml"),
        _ => panic!("no such dataset: {name}"),
    };
    let mut table: Table = text.parse().unwrap();
    let extended = [
        ("world", include_str!("../../configs/world.toml")),
        ("randomization", include_str!("../../configs/randomization.toml")),
    ];
    for (key, text) in extended {
        table.insert(key.to_owned(), text.parse::<Table>().unwrap().into());
    }
    table
}

/// Returns a configuration with a camera of 32 x 24 pixels, `count` rows, and three rows per file.
pub(crate) fn config(name: &str, count: u64) -> DatasetConfig {
    let mut config = DatasetConfig::from_table(table(name)).unwrap();
    (config.count, config.rows_per_shard) = (count, 3);
    (config.world.camera.width, config.world.camera.height) = (32, 24);
    config
}

/// Generates a dataset without reporting progress.
pub(crate) fn make(config: &DatasetConfig, out: &Path) -> Result<Summary> {
    generate(config, out, &Options { stop: &AtomicBool::new(false) }, &|_| {})
}
