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

#[path = "store/card.rs"]
pub mod card;
#[path = "config/mod.rs"]
pub mod config;
#[path = "read/tally.rs"]
mod counts;
#[path = "store/existing_files.rs"]
mod earlier;
pub mod error;
#[path = "row/example.rs"]
pub mod example;
#[path = "defect.rs"]
pub mod fault;
#[path = "row/features.rs"]
pub mod features;
#[path = "store/finish.rs"]
pub mod finish;
#[path = "store/generate.rs"]
pub mod generate;
#[path = "store/info.rs"]
pub mod info;
#[path = "config/objects.rs"]
pub mod object_config;
#[path = "store/part.rs"]
pub mod part;
#[path = "scene/sampler.rs"]
pub mod placement;
#[path = "row/png.rs"]
pub mod png;
#[path = "store/progress.rs"]
pub mod progress;
pub mod publish;
mod queue;
#[path = "scene/randomizer.rs"]
pub mod randomization;
#[path = "config/randomization.rs"]
pub mod randomization_config;
#[path = "scene/pose_range.rs"]
pub mod range;
#[path = "read/reader.rs"]
pub mod reader;
#[path = "store/config_file.rs"]
pub mod recipe;
#[path = "store/shard_record.rs"]
pub mod record;
#[path = "scene/rejection.rs"]
pub mod rejection;
#[path = "read/replay.rs"]
pub mod replay;
#[path = "row/decode.rs"]
pub mod row;
#[path = "row/schema.rs"]
pub mod schema;
#[path = "store/shard.rs"]
pub mod shard;
#[path = "read/running_stats.rs"]
pub mod spread;
#[path = "read/statistics.rs"]
pub mod statistics;
#[cfg(test)]
#[path = "fixture.rs"]
mod tiny;
#[path = "store/verify.rs"]
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
