//! The bytes of a dataset are the same on every machine: digests of small datasets, obtained on x86-64 and on 64-bit Arm.

#![forbid(unsafe_code)]
#![allow(clippy::unwrap_used)]

use datagen::{DatasetConfig, Options, generate};
use std::sync::atomic::AtomicBool;
use toml::Table;

/// Returns a shipped configuration with a small camera and twelve rows.
fn config(dataset: &str) -> DatasetConfig {
    let mut table: Table = dataset.parse().unwrap();
    let extended = [
        ("world", include_str!("../../configs/world.toml")),
        ("randomization", include_str!("../../configs/randomization.toml")),
    ];
    for (key, text) in extended {
        table.insert(key.to_owned(), text.parse::<Table>().unwrap().into());
    }
    let mut config = DatasetConfig::from_table(table).unwrap();
    (config.count, config.rows_per_shard) = (12, 5);
    (config.world.camera.width, config.world.camera.height) = (96, 72);
    config
}

/// Returns the first digits of the digest of a dataset.
fn digest(config: &DatasetConfig) -> String {
    let dir = tempfile::tempdir().unwrap();
    let options = Options { stop: &AtomicBool::new(false) };
    generate(config, dir.path(), &options, &|_| {}).unwrap().digest[..16].to_owned()
}

/// A changed digest means that every dataset changes: record it in CHANGELOG.md.
#[test]
fn datasets_have_the_digests_of_other_machines() {
    let datasets = [
        ("a", include_str!("../../configs/datasets/a.toml"), "944df47e8d59b280"),
        ("b", include_str!("../../configs/datasets/b.toml"), "2d7fba36ad56dee8"),
        ("c", include_str!("../../configs/datasets/c.toml"), "0b9bdb82ef2a26e1"),
        ("avoid", include_str!("../../configs/datasets/avoid.toml"), "304542af705a0356"),
    ];
    let found = datasets.map(|(name, text, _)| (name, digest(&config(text))));
    assert_eq!(found, datasets.map(|(name, _, expected)| (name, expected.to_owned())));
}
