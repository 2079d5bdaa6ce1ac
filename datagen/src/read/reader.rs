//! Reads the rows of a dataset: a range in order, or any rows in any order. Only the requested data are read.

use super::data_file::{DataFile, RowGroup, damaged, wrong_rows};
use crate::error::{Error, Result};
use crate::row::{Batch, Row};
use crate::store::{DatasetInfo, FileRecord};
use arrow_array::RecordBatch;
use parquet::arrow::arrow_reader::ParquetRecordBatchReader;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use std::iter::once;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Reader of a complete dataset. Threads may share it, and clones share the footers that were read.
#[derive(Debug, Clone)]
pub struct DatasetReader {
    opened: Arc<Opened>,
}

#[derive(Debug)]
struct Opened {
    dir: PathBuf,
    info: DatasetInfo,
    files: Vec<DataFile>,
}

impl DatasetReader {
    /// Opens the dataset in a folder. Fails if it is incomplete, or if files are missing or truncated.
    pub fn open(dir: &Path) -> Result<Self> {
        let info = DatasetInfo::read(dir)?;
        info.check_sizes(dir)?;
        let mut end = 0;
        let file = |record: &FileRecord| {
            end += record.rows;
            DataFile::new(dir.join(&record.path), end - record.rows..end)
        };
        let files = info.files.iter().map(file).collect();
        Ok(Self { opened: Arc::new(Opened { dir: dir.to_owned(), info, files }) })
    }

    /// Returns the manifest of the dataset.
    pub fn info(&self) -> &DatasetInfo {
        &self.opened.info
    }

    /// Returns the folder of the dataset.
    pub fn dir(&self) -> &Path {
        &self.opened.dir
    }

    /// Returns the range of rows in each file. Pass these to [`DatasetReader::rows`] to read files in parallel.
    pub fn shards(&self) -> Vec<Range<u64>> {
        self.opened.files.iter().map(|file| file.rows.clone()).collect()
    }

    /// Reads all rows in order.
    pub fn all<R: Row>(&self) -> Result<Rows<R>> {
        self.rows(0..self.info().rows)
    }

    /// Reads a range of rows in order. Rows are decoded as they are consumed.
    pub fn rows<R: Row>(&self, range: Range<u64>) -> Result<Rows<R>> {
        self.check_kind::<R>()?;
        if range.start > range.end || range.end > self.info().rows {
            return Err(self.out_of_range(range));
        }
        Ok(Rows { reader: self.clone(), remaining: range, open: None, decoded: Vec::new().into_iter() })
    }

    /// Reads any rows, in the given order; rows may repeat. Reads row groups in parallel, with the threads of the current rayon
    /// pool.
    pub fn rows_at<R: Row>(&self, rows: &[u64]) -> Result<Vec<R>> {
        self.check_kind::<R>()?;
        let mut sorted = rows.to_vec();
        sorted.sort_unstable();
        sorted.dedup();
        let (mut groups, mut rest) = (Vec::new(), sorted.as_slice());
        while let Some(&first) = rest.first() {
            let group = self.group_of(first)?;
            let (inside, behind) = rest.split_at(rest.partition_point(|&row| row < group.rows.end));
            groups.push((group, inside));
            rest = behind;
        }
        let read: Vec<Result<Vec<R>>> = groups.par_iter().map(|(group, rows)| group.read(rows)).collect();
        let read = read.into_iter().collect::<Result<Vec<_>>>()?.concat();
        Ok(rows.iter().map(|row| read[sorted.partition_point(|other| other < row)].clone()).collect())
    }

    /// Reads one row with all its columns, as stored.
    pub fn record_batch(&self, row: u64) -> Result<RecordBatch> {
        let group = self.group_of(row)?;
        let columns = group.footer.schema().fields();
        let columns: Vec<_> = columns.iter().map(|column| column.name().as_str()).collect();
        match group.open(once(row..row + 1), &columns)?.next() {
            Some(batch) => batch.map_err(|error| damaged(group.path, &error)),
            None => Err(wrong_rows(group.path, 1, 0)),
        }
    }

    fn group_of(&self, row: u64) -> Result<RowGroup<'_>> {
        let files = &self.opened.files;
        match files.get(files.partition_point(|file| file.rows.end <= row)) {
            Some(file) => file.group_of(row),
            None => Err(self.out_of_range(row..row.saturating_add(1))),
        }
    }

    fn check_kind<R: Row>(&self) -> Result<()> {
        let found = self.info().config.kind;
        match R::KIND {
            Some(expected) if expected != found => {
                Err(Error::Kind { dir: self.dir().to_owned(), expected, found })
            }
            _ => Ok(()),
        }
    }

    fn out_of_range(&self, Range { start, end }: Range<u64>) -> Error {
        Error::OutOfRange { dir: self.dir().to_owned(), start, end, rows: self.info().rows }
    }
}

/// Iterator over rows, decoded as they are consumed. It ends after the first error.
pub struct Rows<R> {
    reader: DatasetReader,
    /// Rows after the open group.
    remaining: Range<u64>,
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
                    (self.remaining, self.open) = (0..0, None);
                    return Some(Err(error));
                }
            }
        }
    }
}

impl<R: Row> Rows<R> {
    /// Decodes the next rows or opens the next group. Returns false at the end.
    fn decode_more(&mut self) -> Result<bool> {
        if let Some((path, reader)) = &mut self.open {
            if let Some(columns) = reader.next() {
                let columns = &columns.map_err(|error| damaged(path, &error))?;
                self.decoded = R::decode(&Batch::new(path, columns))?.into_iter();
                return Ok(true);
            }
            self.open = None;
        }
        if self.remaining.is_empty() {
            return Ok(false);
        }
        let group = self.reader.group_of(self.remaining.start)?;
        let end = self.remaining.end.min(group.rows.end);
        let reader = group.open(once(self.remaining.start..end), R::COLUMNS)?;
        self.open = Some((group.path.to_owned(), reader));
        self.remaining.start = end;
        Ok(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DatasetConfig;
    use crate::fixture::{config, make};
    use crate::row::{self, ApproachRow, AvoidanceRow, ExampleGenerator, ImagesRow, SceneRow};
    use crate::store::{ROWS_PER_GROUP, verify};
    use parquet::file::reader::{ChunkReader, Length};
    use std::fs::{self, File};
    use std::sync::Mutex;
    use tempfile::TempDir;

    fn dataset(config: &DatasetConfig) -> (TempDir, DatasetReader) {
        let dir = tempfile::tempdir().unwrap();
        make(config, dir.path()).unwrap();
        let reader = DatasetReader::open(dir.path()).unwrap();
        (dir, reader)
    }

    #[test]
    fn rows_are_read_as_written() {
        let config = config("c", 4);
        let generator = ExampleGenerator::new(&config).unwrap();
        let (_dir, reader) = dataset(&config);
        let rows: Vec<ApproachRow> = reader.all().unwrap().map(Result::unwrap).collect();
        let images: Vec<ImagesRow> = reader.all().unwrap().map(Result::unwrap).collect();
        let scenes: Vec<SceneRow> = reader.all().unwrap().map(Result::unwrap).collect();
        for (index, ((row, images), scene)) in rows.into_iter().zip(images).zip(scenes).enumerate() {
            let example = generator.example(index as u64).unwrap();
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
        let generator = ExampleGenerator::new(&config).unwrap();
        let (_dir, reader) = dataset(&config);
        let images = reader.all::<ImagesRow>().unwrap().map(Result::unwrap);
        for (row, images) in reader.all::<AvoidanceRow>().unwrap().map(Result::unwrap).zip(images) {
            let example = generator.example(row.index).unwrap();
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
    fn any_rows_are_read_in_any_order() {
        let mut config = config("a", 2 * ROWS_PER_GROUP + 10);
        config.rows_per_shard = ROWS_PER_GROUP + 5;
        (config.world.camera.width, config.world.camera.height) = (8, 8);
        let (_dir, reader) = dataset(&config);
        let all: Vec<ImagesRow> = reader.all().unwrap().map(Result::unwrap).collect();
        // Both files, all groups, neighbors, ends of groups, and one row three times.
        let asked = [265, 0, 130, 129, 265, 133, 127, 128, 132, 265, 1];
        let expected: Vec<_> = asked.iter().map(|&row| all[row as usize].clone()).collect();
        std::thread::scope(|scope| {
            for _ in 0..3 {
                scope.spawn(|| assert_eq!(reader.clone().rows_at::<ImagesRow>(&asked).unwrap(), expected));
            }
        });
        let backwards: Vec<u64> = (0..config.count).rev().collect();
        let rows = reader.rows_at::<ImagesRow>(&backwards).unwrap();
        assert!(rows.iter().rev().eq(&all));
        assert_eq!(reader.rows_at::<ImagesRow>(&[]).unwrap(), []);
        let behind = reader.rows_at::<ImagesRow>(&[3, 266]).unwrap_err().to_string();
        assert!(
            behind.contains("requested rows 266 to 267 (exclusive), but the dataset has 266"),
            "{behind}"
        );
        assert!(matches!(reader.rows_at::<AvoidanceRow>(&[3]), Err(Error::Kind { .. })));
    }

    /// A file that records which of its bytes were read.
    struct Watched {
        file: File,
        read: Arc<Mutex<Vec<Range<u64>>>>,
    }

    impl Length for Watched {
        fn len(&self) -> u64 {
            Length::len(&self.file)
        }
    }

    impl ChunkReader for Watched {
        type T = <File as ChunkReader>::T;

        fn get_read(&self, _: u64) -> parquet::errors::Result<Self::T> {
            panic!("a read without a known end")
        }

        fn get_bytes(&self, start: u64, length: usize) -> parquet::errors::Result<bytes::Bytes> {
            self.read.lock().unwrap().push(start..start + length as u64);
            self.file.get_bytes(start, length)
        }
    }

    /// The oracle is the offset index of the file.
    #[test]
    fn only_pages_that_hold_the_rows_are_read() {
        let mut config = config("c", ROWS_PER_GROUP + 2);
        config.rows_per_shard = config.count;
        (config.world.camera.width, config.world.camera.height) = (160, 120);
        let (_dir, reader) = dataset(&config);
        let group = reader.group_of(70).unwrap();
        let footer = group.footer.metadata();
        let (mut expected, mut pages) = (Vec::new(), 0);
        for (i, column) in footer.row_group(0).columns().iter().enumerate() {
            if !["index", "bytes"].contains(&column.column_descr().name()) {
                continue;
            }
            if let Some(dictionary) = column.dictionary_page_offset() {
                expected.push(dictionary as u64..column.data_page_offset() as u64);
            }
            let index = footer.page_index_for_row_group(0);
            let locations = index.offset_index(i).unwrap().page_locations();
            let page = locations.iter().rfind(|page| page.first_row_index <= 70).unwrap();
            expected.push(page.offset as u64..page.offset as u64 + page.compressed_page_size as u64);
            pages += locations.len();
        }
        assert!(pages > 6, "{pages} pages: too few for this test");
        let read = Arc::new(Mutex::new(Vec::new()));
        let file = Watched { file: File::open(group.path).unwrap(), read: read.clone() };
        let mut batches = group.select(file, once(70..71), ImagesRow::COLUMNS).unwrap();
        let columns = &batches.next().unwrap().unwrap();
        let row = &ImagesRow::decode(&Batch::new(group.path, columns)).unwrap()[0];
        assert_eq!(row.index, 70);
        assert_eq!(row.images, ExampleGenerator::new(&config).unwrap().example(70).unwrap().images);
        assert!(batches.next().is_none());
        let mut read = read.lock().unwrap().clone();
        read.sort_by_key(|range| range.start);
        assert_eq!(read, expected);
    }

    #[test]
    fn a_footer_is_read_once() {
        let (dir, reader) = dataset(&config("a", 3));
        let shared = reader.clone();
        let read = |reader: &DatasetReader| reader.rows_at::<ImagesRow>(&[2]).unwrap().remove(0);
        let row = read(&reader);
        // Overwrite the footer.
        let path = dir.path().join(&reader.info().files[0].path);
        let mut bytes = fs::read(&path).unwrap();
        let footer = bytes.len() - 100;
        bytes[footer..].fill(0);
        fs::write(&path, bytes).unwrap();
        assert_eq!(read(&shared), row);
        assert_eq!(reader.rows::<ImagesRow>(2..3).unwrap().next().unwrap().unwrap(), row);
        assert!(DatasetReader::open(dir.path()).unwrap().rows_at::<ImagesRow>(&[2]).is_err());
    }

    #[test]
    fn a_record_batch_has_all_columns() {
        let config = config("avoid", 5);
        let (_dir, reader) = dataset(&config);
        let generator = ExampleGenerator::new(&config).unwrap();
        let made = row::encode(&generator, &[generator.example(4).unwrap()]).unwrap();
        let stored = reader.record_batch(4).unwrap();
        assert_eq!(stored.columns(), made.columns());
        assert!(stored.schema().fields().iter().eq(row::schema(&config).fields()));
        assert!(matches!(reader.record_batch(5), Err(Error::OutOfRange { .. })));
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
        assert!(read().contains("expected a Parquet file written by flowservo"), "{}", read());

        // A readable file of three rows, but of the other kind.
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
        assert!(verify(dir.path()).unwrap().is_empty());
        let path = dir.path().join(&reader.info().files[0].path);
        let mut bytes = fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(&path, bytes).unwrap();
        let error = verify(dir.path()).unwrap()[0].to_string();
        assert!(error.contains("train-00000-of-00001.parquet: expected SHA-256"), "{error}");
    }
}
