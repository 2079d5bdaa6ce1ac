//! Datasets: samples scenes, writes them as Parquet and reads them back (paper, Sections 6.2 and 6.3).
//!
//! The modules follow a row from its configuration to disk and back:
//!
//! 1. [`config`]: the configuration of a dataset is parsed and validated.
//! 2. [`scene`]: a scene and hand poses are drawn until the arm reaches them, the hand touches nothing and the camera sees the
//!    target.
//! 3. [`row`]: the scene is rendered and labeled, and encoded as Arrow columns.
//! 4. [`store`]: rows become Parquet files, and the files become a complete dataset. Several processes or machines can share the
//!    work.
//! 5. [`read`]: any rows are read back, summarized, or generated again and compared.
//!
//! **Invariant:** example `i` is a pure function of (configuration, seed, `i`). The bytes of all files are therefore independent
//! of the number of threads and machines, and any row can be generated again alone.
//!
//! **Invariant:** a folder with `dataset.json` is complete. This file is written last, and contains the digests of the
//! others.
//!
//! ```text
//! OUT/data/train-00000-of-00010.parquet   rows, readable by any Parquet tool
//! OUT/config.toml                         configuration; written first
//! OUT/README.md                           card, with the metadata for Hugging Face
//! OUT/dataset.json                        manifest with configuration and digests; written last
//! OUT/shards/                             records of finished files, while the dataset is incomplete
//! OUT/cache/                              decoded images, written by training; not part of the dataset
//! ```

#![forbid(unsafe_code)]

pub mod config;
mod defect;
pub mod digest;
mod error;
#[cfg(test)]
mod fixture;
pub mod publish;
mod queue;
pub mod read;
pub mod row;
pub mod scene;
pub mod store;

pub use config::{ConfigError, DatasetConfig, Kind};
pub use defect::{Defect, DefectKind};
pub use error::{Error, Result};
pub use read::{DatasetReader, DatasetStatistics, Replay, replay, statistics};
pub use row::{
    ApproachRow, AvoidanceRow, CameraRow, Example, ExampleGenerator, ImagesRow, MotionRow, SceneRow, png,
};
pub use scene::{Placement, Rejections, Sampler};
pub use store::{
    DatasetInfo, Finished, Options, Part, PartSummary, Progress, Shard, Summary, finish, generate,
    generate_part, verify,
};
