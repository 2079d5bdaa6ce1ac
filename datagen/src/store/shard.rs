//! One file of a dataset: its rows in groups, written in order, published by rename.

use crate::config::DatasetConfig;
use crate::error::{Error, Result};
use crate::example::{Collector, Example};
use crate::features;
use crate::info::{FileRecord, config_digest};
use crate::part::Part;
use crate::progress::Run;
use crate::publish::{Hashed, io, publish_alone};
use crate::record::ShardRecord;
use crate::schema::{self, Content};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, Encoding};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::schema::types::ColumnPath;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// Rows in a group: what is held in memory while writing, and what one thread reads.
pub const ROWS_PER_GROUP: u64 = 128;

/// Rows that a thread makes at a time.
const ROWS_PER_BATCH: u64 = 8;

/// Bytes of images in a page, unless one has more: what a reader has to fetch for one image.
const IMAGE_PAGE: usize = 1 << 16;

/// One file of a dataset.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shard {
    /// Name without folder and ending.
    name: String,
    /// Its rows.
    pub rows: Range<u64>,
}

impl Shard {
    /// All shards of a dataset; their names and rows are known before any is made.
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

    /// The shards of a part of a dataset.
    pub fn of_part(config: &DatasetConfig, part: Part) -> Vec<Self> {
        (0..).zip(Self::all(config)).filter(|&(i, _)| part.has(i)).map(|(_, shard)| shard).collect()
    }

    /// Name without folder and ending.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Path of the file below the dataset's folder.
    pub fn path(&self) -> String {
        format!("data/{}.parquet", self.name)
    }

    /// Its rows as they are made: some at a time, since a thread that waits for each goes to sleep and wakes as often.
    pub(crate) fn batches(&self) -> impl Iterator<Item = Range<u64>> + use<> {
        let Range { start, end } = self.rows;
        (start..end)
            .step_by(ROWS_PER_BATCH as usize)
            .map(move |start| start..(start + ROWS_PER_BATCH).min(end))
    }

    /// Writes the examples, a group at a time, and publishes the file, then its record.
    pub(crate) fn write(
        &self,
        collector: &Collector<'_>,
        dir: &Path,
        examples: &mut dyn Iterator<Item = Result<Example>>,
        run: &mut Run<'_>,
    ) -> Result<FileRecord> {
        let path = dir.join(self.path());
        let (sha256, bytes) = publish_alone(&path, |file| {
            let failed = |error| write_failed(&path, error);
            let mut hashed = Hashed::new(file);
            let schema = Arc::new(schema::schema(collector.config()));
            let properties = properties(collector.config());
            let mut writer = ArrowWriter::try_new(&mut hashed, schema, Some(properties)).map_err(failed)?;
            let mut start = self.rows.start;
            while start < self.rows.end {
                let end = (start + ROWS_PER_GROUP).min(self.rows.end);
                let group = (start..end).map(|_| run.take(examples)).collect::<Result<Vec<_>>>()?;
                writer.write(&schema::encode(collector, &group)?).map_err(failed)?;
                writer.flush().map_err(failed)?;
                run.made(end - start);
                start = end;
            }
            writer.close().map_err(failed)?;
            Ok::<_, Error>(hashed.finish())
        })?;
        let file = FileRecord { path: self.path(), sha256, rows: self.rows.end - self.rows.start, bytes };
        let (config_digest, version) =
            (config_digest(collector.config())?, env!("CARGO_PKG_VERSION").to_owned());
        let record = ShardRecord { config_digest, version, file };
        record.publish(self, dir)?;
        run.finished();
        Ok(record.file)
    }
}

fn properties(config: &DatasetConfig) -> WriterProperties {
    let columns = schema::columns(config);
    let features = KeyValue::new(features::KEY.to_owned(), features::json(&columns));
    let mut properties = WriterProperties::builder()
        .set_created_by(format!("flowservo {}", env!("CARGO_PKG_VERSION")))
        .set_compression(Compression::SNAPPY)
        .set_max_row_group_row_count(Some(ROWS_PER_GROUP as usize))
        // The size of a page is looked at once a batch: many images would make a huge one.
        .set_write_batch_size(16)
        .set_key_value_metadata(Some(vec![features]));
    for column in columns.iter().filter(|column| matches!(column.content, Content::Image(..))) {
        let bytes = ColumnPath::new(vec![column.name.to_owned(), "bytes".to_owned()]);
        properties = properties
            .set_column_compression(bytes.clone(), Compression::UNCOMPRESSED)
            .set_column_encoding(bytes.clone(), Encoding::PLAIN)
            .set_column_dictionary_enabled(bytes.clone(), false)
            .set_column_data_page_size_limit(bytes.clone(), IMAGE_PAGE)
            .set_column_statistics_enabled(bytes, EnabledStatistics::None);
    }
    properties.build()
}

fn write_failed(path: &Path, error: ParquetError) -> Error {
    let source = match error {
        ParquetError::External(error) => error.downcast().map_or_else(std::io::Error::other, |error| *error),
        error => std::io::Error::other(error),
    };
    io(path, source)
}
