//! The folder of a dataset, and how it becomes complete.
//!
//! | state | content | effect of [`generate()`] |
//! |---|---|---|
//! | absent | nothing | claims the folder by publishing `config.toml` |
//! | in progress | `config.toml`; finished shards with records in `shards/` | keeps the finished shards, writes the others |
//! | complete | all shards, `README.md`, `config.toml`; `dataset.json`, written last | none |
//! | damaged | a file that differs from its record, or from `dataset.json` | writes this file again |
//! | foreign | another configuration, records of another version, or stray Parquet files | fails |
//!
//! [`generate_part`] writes some of the shards, so that several processes or machines can share the work. The last one, or
//! [`finish()`], completes the dataset. [`verify()`] lists the defects of a complete dataset.
//!
//! Every file is published atomically, and a shard before its record. A process can therefore be killed at any time.

mod card;
mod config_file;
mod existing_files;
mod file_record;
mod finish;
mod generate;
mod info;
mod json;
mod part;
mod progress;
mod shard;
mod shard_record;
mod shard_writer;
mod verify;

pub use file_record::FileRecord;
pub use finish::{Finished, finish};
pub use generate::{PartSummary, Summary, generate, generate_part};
pub use info::DatasetInfo;
pub use part::{InvalidPart, Part};
pub use progress::{Options, Progress};
pub use shard::Shard;
pub use shard_record::finished_shards;
pub use verify::verify;
#[cfg(test)]
pub(crate) use {finish::publish_manifest, shard_writer::ROWS_PER_GROUP};
