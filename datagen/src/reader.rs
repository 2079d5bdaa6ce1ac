//! Reads a dataset back, streaming, a range of rows at a time.

use crate::error::{Error, Result};
use crate::info::{DatasetInfo, FileRecord};
use crate::publish::io;
use crate::row::{Batch, Row};
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderOptions, ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder,
};
use parquet::file::metadata::PageIndexPolicy;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Rows that are decoded at a time: little memory even with large images.
const BATCH: usize = 32;

/// A complete dataset.
#[derive(Debug, Clone)]
pub struct DatasetReader {
    dir: PathBuf,
    info: DatasetInfo,
}

impl DatasetReader {
    /// Opens a folder; refuses an incomplete dataset, and one whose files are missing or cut short.
    pub fn open(dir: &Path) -> Result<Self> {
        let info = DatasetInfo::read(dir)?;
        info.check_sizes(dir)?;
        Ok(Self { dir: dir.to_owned(), info })
    }

    /// What the dataset is made of.
    pub fn info(&self) -> &DatasetInfo {
        &self.info
    }

    /// The dataset's folder.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The range of indices of each file: what to hand to [`DatasetReader::rows`] to read files in parallel.
    pub fn shards(&self) -> Vec<Range<u64>> {
        let mut end = 0;
        let shard = |file: &FileRecord| {
            end += file.rows;
            end - file.rows..end
        };
        self.info.files.iter().map(shard).collect()
    }

    /// All rows in order.
    pub fn all<R: Row>(&self) -> Result<Rows<R>> {
        self.rows(0..self.info.rows)
    }

    /// The rows of a range of indices, in order. A short range reads little more than its rows.
    pub fn rows<R: Row>(&self, range: Range<u64>) -> Result<Rows<R>> {
        let (dir, found) = (self.dir.clone(), self.info.config.kind);
        if let Some(expected) = R::KIND.filter(|&kind| kind != found) {
            return Err(Error::Kind { dir, expected, found });
        }
        let (start, end, rows) = (range.start, range.end, self.info.rows);
        if start > end || end > rows {
            return Err(Error::OutOfRange { dir, start, end, rows });
        }
        let mut parts = Vec::new();
        for (file, shard) in self.info.files.iter().zip(self.shards()) {
            let (from, to) = (start.max(shard.start), end.min(shard.end));
            if from < to {
                let rows = (from - shard.start) as usize..(to - shard.start) as usize;
                parts.push(Part { path: dir.join(&file.path), rows_in_file: file.rows, rows });
            }
        }
        Ok(Rows { parts: parts.into_iter(), open: None, decoded: Vec::new().into_iter() })
    }
}

/// Rows of one file.
struct Part {
    path: PathBuf,
    rows_in_file: u64,
    rows: Range<usize>,
}

/// Rows, decoded as they are asked for. Ends after the first error.
pub struct Rows<R> {
    parts: std::vec::IntoIter<Part>,
    open: Option<(PathBuf, ParquetRecordBatchReader)>,
    decoded: std::vec::IntoIter<R>,
}

impl<R: Row> Iterator for Rows<R> {
    type Item = Result<R>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(row) = self.decoded.next() {
                return Some(Ok(row));
            }
            match self.decode_more() {
                Ok(true) => {}
                Ok(false) => return None,
                Err(error) => {
                    (self.parts, self.open) = (Vec::new().into_iter(), None);
                    return Some(Err(error));
                }
            }
        }
    }
}

impl<R: Row> Rows<R> {
    /// Decodes the next rows, or opens the next file; false where there is none.
    fn decode_more(&mut self) -> Result<bool> {
        if let Some((path, reader)) = &mut self.open {
            if let Some(columns) = reader.next() {
                let columns = &columns.map_err(|error| damaged(path, &error))?;
                self.decoded = R::decode(&Batch { path, columns })?.into_iter();
                return Ok(true);
            }
            self.open = None;
        }
        let Some(part) = self.parts.next() else { return Ok(false) };
        let reader = open(&part, R::COLUMNS)?;
        self.open = Some((part.path, reader));
        Ok(true)
    }
}

/// Opens a file for some of its rows and columns; groups of rows outside are not touched.
fn open(part: &Part, columns: &[&str]) -> Result<ParquetRecordBatchReader> {
    let path = &part.path;
    let file = File::open(path).map_err(|source| io(path, source))?;
    let options = ArrowReaderOptions::new().with_offset_index_policy(PageIndexPolicy::Optional);
    let builder = ParquetRecordBatchReaderBuilder::try_new_with_options(file, options)
        .map_err(|error| damaged(path, &error))?;
    let found = builder.metadata().file_metadata().num_rows();
    if u64::try_from(found) != Ok(part.rows_in_file) {
        let [expected, found] = [format!("{} rows", part.rows_in_file), format!("{found} rows")];
        return Err(Error::Damaged { path: path.clone(), expected, found });
    }
    let (mut groups, mut offset, mut start) = (Vec::new(), 0, 0);
    for (i, group) in builder.metadata().row_groups().iter().enumerate() {
        let end = start + group.num_rows() as usize;
        if end <= part.rows.start {
            offset = end;
        } else if start < part.rows.end {
            groups.push(i);
        }
        start = end;
    }
    let mask = ProjectionMask::columns(builder.parquet_schema(), columns.iter().copied());
    let reader = builder
        .with_row_groups(groups)
        .with_offset(part.rows.start - offset)
        .with_limit(part.rows.len())
        .with_projection(mask)
        .with_batch_size(BATCH);
    reader.build().map_err(|error| damaged(path, &error))
}

pub(crate) fn damaged(path: &Path, error: &dyn std::error::Error) -> Error {
    Error::Damaged {
        path: path.to_owned(),
        expected: "a Parquet file of flowservo".to_owned(),
        found: error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DatasetConfig;
    use crate::example::Collector;
    use crate::row::{ApproachRow, AvoidanceRow, ImagesRow, SceneRow};
    use crate::shard::ROWS_PER_GROUP;
    use crate::tiny::{config, make};
    use std::fs;
    use tempfile::TempDir;

    fn dataset(config: &DatasetConfig) -> (TempDir, DatasetReader) {
        let dir = tempfile::tempdir().unwrap();
        make(config, dir.path()).unwrap();
        let reader = DatasetReader::open(dir.path()).unwrap();
        (dir, reader)
    }

    #[test]
    fn what_was_written_is_read() {
        let config = config("c", 4);
        let collector = Collector::new(&config).unwrap();
        let (_dir, reader) = dataset(&config);
        let rows: Vec<ApproachRow> = reader.all().unwrap().map(Result::unwrap).collect();
        let images: Vec<ImagesRow> = reader.all().unwrap().map(Result::unwrap).collect();
        let scenes: Vec<SceneRow> = reader.all().unwrap().map(Result::unwrap).collect();
        for (index, ((row, images), scene)) in rows.into_iter().zip(images).zip(scenes).enumerate() {
            let example = collector.example(index as u64).unwrap();
            let hands = example.placement.hands.iter().map(|hand| hand.pose.robot_from_hand());
            assert_eq!(row.index, index as u64);
            assert_eq!(images, ImagesRow { index: index as u64, images: example.images });
            assert_eq!(vec![row.robot_from_current, row.robot_from_goal], hands.collect::<Vec<_>>());
            assert_eq!(scene.scene, example.placement.scene);
        }
    }

    #[test]
    fn avoidance_maps_are_read() {
        let config = config("avoid", 4);
        let collector = Collector::new(&config).unwrap();
        let (_dir, reader) = dataset(&config);
        let images = reader.all::<ImagesRow>().unwrap().map(Result::unwrap);
        for (row, images) in reader.all::<AvoidanceRow>().unwrap().map(Result::unwrap).zip(images) {
            let example = collector.example(row.index).unwrap();
            assert_eq!(images, ImagesRow { index: row.index, images: example.images });
            assert_eq!(row.values, example.avoidance);
            assert_eq!(row.robot_from_hand, example.placement.hands[0].pose.robot_from_hand());
        }
    }

    #[test]
    fn any_range_of_rows_is_read() {
        let mut config = config("a", 2 * ROWS_PER_GROUP + 10);
        config.rows_per_shard = ROWS_PER_GROUP + 5;
        (config.world.camera.width, config.world.camera.height) = (8, 8);
        let (_dir, reader) = dataset(&config);
        let all: Vec<ImagesRow> = reader.all().unwrap().map(Result::unwrap).collect();
        assert_eq!(
            all.iter().map(|row| row.index).collect::<Vec<_>>(),
            (0..config.count).collect::<Vec<_>>()
        );
        for range in [0..0, 0..1, 127..129, 128..130, 131..135, 130..262, 262..263, 265..266, 0..266] {
            let rows: Vec<ImagesRow> = reader.rows(range.clone()).unwrap().map(Result::unwrap).collect();
            assert_eq!(rows, all[range.start as usize..range.end as usize], "{range:?}");
        }
        assert_eq!(reader.shards(), [0..133, 133..266]);
        assert!(matches!(reader.rows::<ApproachRow>(0..267), Err(Error::OutOfRange { .. })));
    }

    #[test]
    fn a_dataset_of_the_other_kind_is_refused() {
        let (_dir, reader) = dataset(&config("a", 1));
        let error = reader.all::<AvoidanceRow>().err().unwrap().to_string();
        assert!(error.contains("is a dataset of kind approach; avoidance is needed here"), "{error}");
    }

    #[test]
    fn a_file_that_is_missing_truncated_or_foreign_is_named() {
        let (dir, reader) = dataset(&config("a", 3));
        let path = dir.path().join(&reader.info().files[0].path);
        let whole = fs::read(&path).unwrap();
        let read = || reader.all::<ApproachRow>().unwrap().next().unwrap().unwrap_err().to_string();

        fs::write(&path, &whole[..whole.len() / 2]).unwrap();
        let truncated = DatasetReader::open(dir.path()).unwrap_err().to_string();
        let expected = format!("expected {} bytes, found {}", whole.len(), whole.len() / 2);
        assert!(
            truncated.contains("train-00000-of-00001.parquet") && truncated.contains(&expected),
            "{truncated}"
        );
        assert!(read().contains("expected a Parquet file of flowservo"), "{}", read());

        // A readable file, of three rows, but of the other kind.
        let (other, _) = dataset(&config("avoid", 3));
        fs::copy(other.path().join("data/train-00000-of-00001.parquet"), &path).unwrap();
        let foreign = read();
        assert!(
            foreign.contains("expected column pose_current") && foreign.contains("no such column"),
            "{foreign}"
        );

        fs::remove_file(&path).unwrap();
        assert!(
            DatasetReader::open(dir.path()).unwrap_err().to_string().contains("train-00000-of-00001.parquet")
        );
    }

    #[test]
    fn a_changed_byte_is_found_by_its_digest() {
        let (dir, reader) = dataset(&config("a", 3));
        reader.info().verify(dir.path()).unwrap();
        let path = dir.path().join(&reader.info().files[0].path);
        let mut bytes = fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(&path, bytes).unwrap();
        let error = reader.info().verify(dir.path()).unwrap_err().to_string();
        assert!(error.contains("train-00000-of-00001.parquet: expected SHA-256"), "{error}");
    }
}
