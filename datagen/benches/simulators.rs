//! The flowservo side of the comparison with simulators: renders the images of a dataset without writing one.
//!
//! `datagen/benches/simulators.sh` runs it as `simulators CONFIG` with the complete `config.toml` of a dataset. It answers
//! each line of standard input with a line of JSON:
//!
//! ```text
//! measure    {"images": seconds, "PNG": seconds} to render all images, and to render and encode them, on all cores
//! ```
#![allow(clippy::print_stdout, missing_docs)]

use datagen::{DatasetConfig, ExampleGenerator, png};
use rayon::iter::{IntoParallelIterator, IntoParallelRefIterator, ParallelIterator};
use std::error::Error;
use std::hint::black_box;
use std::io::stdin;
use std::time::Instant;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

fn main() -> Result<()> {
    // `cargo bench` runs every benchmark and passes a flag.
    let Some(file) = std::env::args().nth(1).filter(|argument| !argument.starts_with('-')) else {
        println!("run datagen/benches/simulators.sh instead");
        return Ok(());
    };
    let config = DatasetConfig::from_table(std::fs::read_to_string(file)?.parse()?)?;
    let generator = ExampleGenerator::new(&config)?;
    let placements = (0..config.count)
        .into_par_iter()
        .map(|index| generator.example(index).map(|example| example.placement))
        .collect::<datagen::Result<Vec<_>>>()?;
    let images = |consume: &(dyn Fn(&image::RgbImage) + Sync)| {
        let start = Instant::now();
        placements.par_iter().for_each(|placement| {
            for hand in &placement.hands {
                let robot_from_hand = hand.pose.robot_from_hand();
                consume(&generator.environment().wrist_image(&placement.scene, &robot_from_hand));
            }
        });
        start.elapsed().as_secs_f64()
    };
    for _ in stdin().lines() {
        let render = images(&|image| {
            black_box(image);
        });
        let png = images(&|image| {
            black_box(png::encode(image).is_ok());
        });
        println!("{}", serde_json::json!({ "images": render, "PNG": png }));
    }
    Ok(())
}
