//! One file of a dataset: its rows in groups, made in parallel, written in order, published by rename.

use crate::config::DatasetConfig;
use crate::error::{Error, Result};
use crate::example::{Collector, Example};
use crate::features;
use crate::info::{FileRecord, read_json, write_json};
use crate::progress::Run;
use crate::publish::{io, publish};
use crate::schema::{self, Content};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, Encoding};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::schema::types::ColumnPath;
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

/// Rows in a group: what is held in memory while writing, and what one thread reads.
pub const ROWS_PER_GROUP: u64 = 128;

/// Bytes of images in a page, unless one has more: what a reader has to fetch for one image.
const IMAGE_PAGE: usize = 1 << 16;

/// Folder of the records, while the dataset is incomplete.
pub const RECORDS: &str = "shards";

/// One file of a dataset.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Shard {
    /// Name without folder and ending.
    name: String,
    /// Its rows.
    pub rows: Range<u64>,
}

/// What is known of a finished shard while the dataset is incomplete.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShardRecord {
    /// Digest of the configuration that it belongs to.
    pub config_digest: String,
    /// The file.
    pub file: FileRecord,
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

    /// Path of the file below the dataset's folder.
    pub fn path(&self) -> String {
        format!("data/{}.parquet", self.name)
    }

    /// Makes the rows, a group at a time, and publishes the file, then its record.
    pub(crate) fn write(
        &self,
        collector: &Collector<'_>,
        dir: &Path,
        config_digest: &str,
        run: &mut Run<'_>,
    ) -> Result<FileRecord> {
        let path = dir.join(self.path());
        publish(&path, |file| {
            let failed = |error| write_failed(&path, error);
            let schema = Arc::new(schema::schema(collector.config()));
            let properties = properties(collector.config());
            let mut writer = ArrowWriter::try_new(file, schema, Some(properties)).map_err(failed)?;
            let mut start = self.rows.start;
            while start < self.rows.end {
                run.check()?;
                let end = (start + ROWS_PER_GROUP).min(self.rows.end);
                let examples = examples(collector, start..end)?;
                writer.write(&schema::encode(collector, &examples)?).map_err(failed)?;
                writer.flush().map_err(failed)?;
                run.made(end - start);
                start = end;
            }
            writer.close().map_err(failed)?;
            Ok::<_, Error>(())
        })?;
        let file = FileRecord::of(dir, self.path(), self.rows.end - self.rows.start)?;
        let record = ShardRecord { config_digest: config_digest.to_owned(), file };
        write_json(&dir.join(RECORDS).join(format!("{}.json", self.name)), &record)?;
        Ok(record.file)
    }
}

impl ShardRecord {
    /// The records that earlier runs left in a dataset's folder.
    pub fn all(dir: &Path) -> Result<Vec<Self>> {
        let records = dir.join(RECORDS);
        if !records.exists() {
            return Ok(Vec::new());
        }
        let mut paths = Vec::new();
        for entry in std::fs::read_dir(&records).map_err(|source| io(&records, source))? {
            let path = entry.map_err(|source| io(&records, source))?.path();
            if path.extension().is_some_and(|extension| extension == "json") {
                paths.push(path);
            }
        }
        paths.sort();
        paths.iter().map(|path| read_json(path)).collect()
    }
}

/// In parallel, in order; of several errors the first row's, at any number of threads.
fn examples(collector: &Collector<'_>, rows: Range<u64>) -> Result<Vec<Example>> {
    let results: Vec<Result<Example>> = rows.into_par_iter().map(|index| collector.example(index)).collect();
    results.into_iter().collect()
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
    io(path, std::io::Error::other(error))
}
