//! Reads a dataset back: a range of rows in order, or any rows in any order. Nothing is loaded but what is asked for.
//!
//! The footer of a file is read when its first row is asked for, and kept. It says where each page of each column lies, so
//! that of the pages only those are read that hold a row which is asked for.

use crate::error::{Error, Result};
use crate::info::{DatasetInfo, FileRecord};
use crate::publish::io;
use crate::row::{Batch, Row};
use arrow_array::RecordBatch;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder,
    RowSelection, RowSelectionPolicy,
};
use parquet::file::metadata::PageIndexPolicy;
use parquet::file::reader::ChunkReader;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use std::fmt::Display;
use std::fs::File;
use std::iter::once;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

/// Rows that are decoded at a time: little memory even with large images.
const BATCH: usize = 32;

/// A complete dataset. Threads may share it; a clone shares what was read of it.
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
    /// Opens a folder; refuses an incomplete dataset, and one whose files are missing or cut short.
    pub fn open(dir: &Path) -> Result<Self> {
        let info = DatasetInfo::read(dir)?;
        info.check_sizes(dir)?;
        let mut end = 0;
        let file = |record: &FileRecord| {
            end += record.rows;
            let path = dir.join(&record.path);
            DataFile { path, rows: end - record.rows..end, footer: OnceLock::new() }
        };
        let files = info.files.iter().map(file).collect();
        Ok(Self { opened: Arc::new(Opened { dir: dir.to_owned(), info, files }) })
    }

    /// What the dataset is made of.
    pub fn info(&self) -> &DatasetInfo {
        &self.opened.info
    }

    /// The dataset's folder.
    pub fn dir(&self) -> &Path {
        &self.opened.dir
    }

    /// The range of indices of each file: what to hand to [`DatasetReader::rows`] to read files in parallel.
    pub fn shards(&self) -> Vec<Range<u64>> {
        self.opened.files.iter().map(|file| file.rows.clone()).collect()
    }

    /// All rows in order.
    pub fn all<R: Row>(&self) -> Result<Rows<R>> {
        self.rows(0..self.info().rows)
    }

    /// The rows of a range of indices, in order, decoded as they are asked for.
    pub fn rows<R: Row>(&self, range: Range<u64>) -> Result<Rows<R>> {
        self.check_kind::<R>()?;
        if range.start > range.end || range.end > self.info().rows {
            return Err(self.out_of_range(range));
        }
        Ok(Rows { reader: self.clone(), left: range, open: None, decoded: Vec::new().into_iter() })
    }

    /// Any rows, in the order asked for, as often as asked for. Groups of rows are read in parallel, by the threads of the
    /// current rayon pool.
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

    /// One row with all its columns, as they are stored.
    pub fn record(&self, row: u64) -> Result<RecordBatch> {
        let group = self.group_of(row)?;
        let columns = group.footer.schema().fields();
        let columns: Vec<_> = columns.iter().map(|column| column.name().as_str()).collect();
        match group.open(once(row..row + 1), &columns)?.next() {
            Some(record) => record.map_err(|error| damaged(group.path, &error)),
            None => Err(wrong_rows(group.path, 1, 0)),
        }
    }

    /// Where a row lies.
    fn group_of(&self, row: u64) -> Result<Group<'_>> {
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

/// One file.
#[derive(Debug)]
struct DataFile {
    path: PathBuf,
    /// Of the dataset.
    rows: Range<u64>,
    footer: OnceLock<ArrowReaderMetadata>,
}

impl DataFile {
    fn footer(&self) -> Result<&ArrowReaderMetadata> {
        if let Some(footer) = self.footer.get() {
            return Ok(footer);
        }
        let file = File::open(&self.path).map_err(|source| io(&self.path, source))?;
        let options = ArrowReaderOptions::new().with_offset_index_policy(PageIndexPolicy::Optional);
        let footer =
            ArrowReaderMetadata::load(&file, options).map_err(|error| damaged(&self.path, &error))?;
        let (expected, found) =
            (self.rows.end - self.rows.start, footer.metadata().file_metadata().num_rows());
        if u64::try_from(found) != Ok(expected) {
            return Err(wrong_rows(&self.path, expected, found));
        }
        // If another thread was faster, its footer is kept.
        Ok(self.footer.get_or_init(|| footer))
    }

    fn group_of(&self, row: u64) -> Result<Group<'_>> {
        let footer = self.footer()?;
        let mut end = self.rows.start;
        for (number, group) in footer.metadata().row_groups().iter().enumerate() {
            let start = end;
            end += group.num_rows() as u64;
            if row < end {
                return Ok(Group { path: &self.path, footer, number, rows: start..end });
            }
        }
        Err(wrong_rows(&self.path, self.rows.end - self.rows.start, end - self.rows.start))
    }
}

/// Rows that lie together in a file: what is read by one thread.
struct Group<'a> {
    path: &'a Path,
    footer: &'a ArrowReaderMetadata,
    /// In the file.
    number: usize,
    /// Of the dataset.
    rows: Range<u64>,
}

impl Group<'_> {
    /// Some of its rows, ascending.
    fn read<R: Row>(&self, rows: &[u64]) -> Result<Vec<R>> {
        let Self { path, .. } = *self;
        let mut read = Vec::with_capacity(rows.len());
        for columns in self.open(rows.iter().map(|&row| row..row + 1), R::COLUMNS)? {
            let columns = &columns.map_err(|error| damaged(path, &error))?;
            read.extend(R::decode(&Batch { path, columns })?);
        }
        if read.len() == rows.len() { Ok(read) } else { Err(wrong_rows(path, rows.len(), read.len())) }
    }

    /// Opens the file for some of its rows, ascending, and columns.
    fn open(
        &self,
        rows: impl Iterator<Item = Range<u64>>,
        columns: &[&str],
    ) -> Result<ParquetRecordBatchReader> {
        // Opened again for every group: threads that share an open file would move each other's position in it.
        let file = File::open(self.path).map_err(|source| io(self.path, source))?;
        self.select(file, rows, columns)
    }

    fn select<T: ChunkReader + 'static>(
        &self,
        file: T,
        rows: impl Iterator<Item = Range<u64>>,
        columns: &[&str],
    ) -> Result<ParquetRecordBatchReader> {
        let Range { start, end } = self.rows;
        let within = rows.map(|rows| (rows.start - start) as usize..(rows.end - start) as usize);
        let selection = RowSelection::from_consecutive_ranges(within, (end - start) as usize);
        let mask = ProjectionMask::columns(self.footer.parquet_schema(), columns.iter().copied());
        let reader = ParquetRecordBatchReaderBuilder::new_with_metadata(file, self.footer.clone())
            .with_row_groups(vec![self.number])
            .with_row_selection(selection)
            // A mask would read pages between the rows, too.
            .with_row_selection_policy(RowSelectionPolicy::Selectors)
            .with_projection(mask)
            .with_batch_size(BATCH);
        reader.build().map_err(|error| damaged(self.path, &error))
    }
}

/// Rows, decoded as they are asked for. Ends after the first error.
pub struct Rows<R> {
    reader: DatasetReader,
    /// Those behind what is open.
    left: Range<u64>,
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
                    (self.left, self.open) = (0..0, None);
                    return Some(Err(error));
                }
            }
        }
    }
}

impl<R: Row> Rows<R> {
    /// Decodes the next rows, or opens the next group; false where there is none.
    fn decode_more(&mut self) -> Result<bool> {
        if let Some((path, reader)) = &mut self.open {
            if let Some(columns) = reader.next() {
                let columns = &columns.map_err(|error| damaged(path, &error))?;
                self.decoded = R::decode(&Batch { path, columns })?.into_iter();
                return Ok(true);
            }
            self.open = None;
        }
        if self.left.is_empty() {
            return Ok(false);
        }
        let group = self.reader.group_of(self.left.start)?;
        let end = self.left.end.min(group.rows.end);
        let reader = group.open(once(self.left.start..end), R::COLUMNS)?;
        self.open = Some((group.path.to_owned(), reader));
        self.left.start = end;
        Ok(true)
    }
}

pub(crate) fn damaged(path: &Path, error: &dyn std::error::Error) -> Error {
    Error::Damaged {
        path: path.to_owned(),
        expected: "a Parquet file of flowservo".to_owned(),
        found: error.to_string(),
    }
}

fn wrong_rows(path: &Path, expected: impl Display, found: impl Display) -> Error {
    let [expected, found] = [format!("{expected} rows"), format!("{found} rows")];
    Error::Damaged { path: path.to_owned(), expected, found }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DatasetConfig;
    use crate::example::Collector;
    use crate::row::{ApproachRow, AvoidanceRow, ImagesRow, SceneRow};
    use crate::schema;
    use crate::shard::ROWS_PER_GROUP;
    use crate::tiny::{config, make};
    use parquet::file::reader::Length;
    use std::fs;
    use std::sync::Mutex;
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
    fn any_rows_are_read_in_any_order() {
        let mut config = config("a", 2 * ROWS_PER_GROUP + 10);
        config.rows_per_shard = ROWS_PER_GROUP + 5;
        (config.world.camera.width, config.world.camera.height) = (8, 8);
        let (_dir, reader) = dataset(&config);
        let all: Vec<ImagesRow> = reader.all().unwrap().map(Result::unwrap).collect();
        // Both files, all groups, neighbors and the ends of groups, one row three times.
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
        assert!(behind.contains("rows 266 to 267 asked for, but the dataset has 266"), "{behind}");
        assert!(matches!(reader.rows_at::<AvoidanceRow>(&[3]), Err(Error::Kind { .. })));
    }

    /// A file that remembers which of its bytes were read.
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
            panic!("read up to an end that is not known")
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
        let row = &ImagesRow::decode(&Batch { path: group.path, columns }).unwrap()[0];
        assert_eq!(row.index, 70);
        assert_eq!(row.images, Collector::new(&config).unwrap().example(70).unwrap().images);
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
        // Where the footer was, nothing is legible any more.
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
    fn a_record_has_all_columns() {
        let config = config("avoid", 5);
        let (_dir, reader) = dataset(&config);
        let collector = Collector::new(&config).unwrap();
        let made = schema::encode(&collector, &[collector.example(4).unwrap()]).unwrap();
        let stored = reader.record(4).unwrap();
        assert_eq!(stored.columns(), made.columns());
        assert!(stored.schema().fields().iter().eq(schema::schema(&config).fields()));
        assert!(matches!(reader.record(5), Err(Error::OutOfRange { .. })));
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
