//! Datasets: samples worlds, writes them as Parquet and reads them back (paper, Sections 6.2 and 6.3).
//!
//! One example is drawn from one random stream: motion, target, hand poses and obstacles, again until the arm reaches the
//! poses, the hand touches nothing and the camera sees the target ([`placement`]). It is rendered and labeled
//! ([`example`]), becomes a row ([`schema`]), and rows become files that are published by rename ([`mod@generate`]). Several
//! processes or machines may each make a [`part`] of the files; who comes last, or [`mod@finish`], completes the dataset. A
//! [`reader`] gives any rows back, and [`mod@replay`] makes one again to compare it with what is stored.
//!
//! **Invariant:** example `i` is a pure function of (configuration, seed, `i`), so files have the same bytes at any number of
//! threads, and any row can be made again alone.
//!
//! **Invariant:** a folder with `dataset.json` is complete; it is written last, and names the digest of every file.
//!
//! ```text
//! OUT/data/train-00000-of-00010.parquet   rows, openable by any Parquet reader
//! OUT/config.toml                         configuration; written first, so that an unfinished folder says what it is
//! OUT/README.md                           the card, with what Hugging Face needs
//! OUT/dataset.json                        configuration, digests; written last
//! OUT/shards/                             digests of finished files, while the dataset is incomplete
//! OUT/cache/                              no part of the dataset: what training makes of the images
//! ```

#![forbid(unsafe_code)]

pub mod card;
pub mod config;
mod counts;
mod earlier;
pub mod error;
pub mod example;
pub mod fault;
pub mod features;
pub mod finish;
pub mod generate;
pub mod info;
pub mod object_config;
pub mod part;
pub mod placement;
pub mod png;
pub mod progress;
pub mod publish;
mod queue;
pub mod randomization;
pub mod randomization_config;
pub mod range;
pub mod reader;
pub mod recipe;
pub mod record;
pub mod rejection;
pub mod replay;
pub mod row;
pub mod schema;
pub mod shard;
pub mod spread;
pub mod statistics;
#[cfg(test)]
mod tiny;
pub mod verify;

pub use config::{DatasetConfig, Kind};
pub use error::{Error, Result};
pub use example::{Collector, Example};
pub use fault::Fault;
pub use finish::finish;
pub use generate::{PartSummary, Summary, generate, generate_part};
pub use info::DatasetInfo;
pub use part::Part;
pub use placement::{Placement, Sampler};
pub use progress::{Options, Progress};
pub use reader::DatasetReader;
pub use replay::{Replay, replay};
pub use row::{ApproachRow, AvoidanceRow, CameraRow, ImagesRow, MotionRow, SceneRow};
pub use statistics::DatasetStatistics;
pub use verify::verify;
