//! Writes one shard: a Parquet file, and then its record.

use super::config_file::config_digest;
use super::file_record::FileRecord;
use super::progress::Monitor;
use super::shard::Shard;
use super::shard_record::ShardRecord;
use crate::config::DatasetConfig;
use crate::digest::HashingWriter;
use crate::error::{Error, Result};
use crate::publish::publish_alone;
use crate::row::{self, Content, Example, ExampleGenerator, features};
use parquet::arrow::ArrowWriter;
use parquet::basic::{Compression, Encoding};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::schema::types::ColumnPath;
use std::path::Path;
use std::sync::Arc;

/// Rows per row group: the rows held in memory while writing, and the rows read by one thread.
pub(crate) const ROWS_PER_GROUP: u64 = 128;

/// Size of a page of images, unless a single image is larger. A reader fetches a page to read one image.
const IMAGE_PAGE: usize = 1 << 16;

/// Writes examples as a shard, one row group at a time. Publishes the file, and then its record.
pub(super) fn write_shard(
    shard: &Shard,
    generator: &ExampleGenerator<'_>,
    dir: &Path,
    examples: &mut dyn Iterator<Item = Result<Example>>,
    monitor: &mut Monitor<'_>,
) -> Result<FileRecord> {
    let path = dir.join(shard.path());
    let (sha256, bytes) = publish_alone(&path, |file| {
        let failed = |error| write_failed(&path, error);
        let mut output = HashingWriter::new(file);
        let schema = Arc::new(row::schema(generator.config()));
        let properties = properties(generator.config());
        let mut writer = ArrowWriter::try_new(&mut output, schema, Some(properties)).map_err(failed)?;
        let mut start = shard.rows.start;
        while start < shard.rows.end {
            let end = (start + ROWS_PER_GROUP).min(shard.rows.end);
            let group = (start..end).map(|_| monitor.next(examples)).collect::<Result<Vec<_>>>()?;
            writer.write(&row::encode(generator, &group)?).map_err(failed)?;
            writer.flush().map_err(failed)?;
            monitor.wrote_rows(end - start);
            start = end;
        }
        writer.close().map_err(failed)?;
        Ok::<_, Error>(output.finish())
    })?;
    let record = ShardRecord {
        config_digest: config_digest(generator.config())?,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        file: FileRecord { path: shard.path(), sha256, rows: shard.row_count(), bytes },
    };
    record.publish(shard, dir)?;
    monitor.finished_file();
    Ok(record.file)
}

fn properties(config: &DatasetConfig) -> WriterProperties {
    let columns = row::columns(config);
    let features = KeyValue::new(features::KEY.to_owned(), features::json(&columns));
    let mut properties = WriterProperties::builder()
        .set_created_by(format!("flowservo {}", env!("CARGO_PKG_VERSION")))
        .set_compression(Compression::SNAPPY)
        .set_max_row_group_row_count(Some(ROWS_PER_GROUP as usize))
        // The writer checks the page size once per batch. A batch of many images would produce a huge page.
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
    Error::io(path)(source)
}
