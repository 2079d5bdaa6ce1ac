//! Time per row of the shipped datasets, by stage and in total: `cargo bench -p datagen`.
#![allow(clippy::unwrap_used)]

use datagen::scene::stream;
use datagen::{DatasetConfig, ExampleGenerator, Options, Sampler, generate, png};
use divan::Bencher;
use divan::counter::ItemsCount;
use std::cell::Cell;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use world::Environment;

fn main() {
    divan::main();
}

const DATASETS: [&str; 4] = ["a", "b", "c", "avoid"];

/// Number of rows in the benchmark that generates a whole dataset.
const ROWS: u64 = 256;

/// Returns a file of `configs/datasets/` with `extends` resolved.
fn config(name: &str) -> DatasetConfig {
    let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
    let read =
        |file: &str| -> toml::Table { std::fs::read_to_string(configs.join(file)).unwrap().parse().unwrap() };
    let mut table = read(&format!("datasets/{name}.toml"));
    for extended in ["world", "randomization"] {
        table.insert(extended.to_owned(), read(&format!("{extended}.toml")).into());
    }
    DatasetConfig::from_table(table).unwrap()
}

/// Counts 0, 1, 2, ... from call to call, because rows differ in cost.
fn counter() -> impl Fn() -> u64 {
    let next = Cell::new(0);
    move || next.replace(next.get() + 1)
}

/// Returns the first image of Dataset C.
fn image() -> Vec<u8> {
    let config = config("c");
    ExampleGenerator::new(&config).unwrap().example(0).unwrap().images.swap_remove(0)
}

#[divan::bench]
fn png_encode(bencher: Bencher) {
    let image = png::decode(&image()).unwrap();
    bencher.counter(ItemsCount::new(1_u32)).bench(|| png::encode(&image));
}

#[divan::bench]
fn png_decode(bencher: Bencher) {
    let bytes = image();
    bencher.counter(ItemsCount::new(1_u32)).bench(|| png::decode(&bytes));
}

/// Drawing an acceptable scene with hand poses.
#[divan::bench(args = DATASETS)]
fn placement(bencher: Bencher, name: &str) {
    let config = config(name);
    let environment = Environment::new(&config.world).unwrap();
    let DatasetConfig { target, obstacles, motions, rejection, .. } = &config;
    let sampler = Sampler::new(&environment, target, obstacles, motions, rejection);
    let index = counter();
    let draw = || sampler.draw(&mut stream(config.seed, index()));
    bencher.counter(ItemsCount::new(1_u32)).bench_local(draw);
}

/// Generating a whole row on one thread.
#[divan::bench(args = DATASETS)]
fn example(bencher: Bencher, name: &str) {
    let config = config(name);
    let generator = ExampleGenerator::new(&config).unwrap();
    let index = counter();
    bencher.counter(ItemsCount::new(1_u32)).bench_local(|| generator.example(index()));
}

/// Generating a dataset on disk with all threads.
#[divan::bench(args = DATASETS, sample_count = 5)]
fn dataset(bencher: Bencher, name: &str) {
    let mut config = config(name);
    config.count = ROWS;
    let options = Options { stop: &AtomicBool::new(false) };
    let made = |folder: tempfile::TempDir| generate(&config, folder.path(), &options, &|_| {}).unwrap();
    bencher
        .counter(ItemsCount::new(ROWS))
        .with_inputs(|| tempfile::tempdir().unwrap())
        .bench_local_values(made);
}
