//! One Parquet file of a dataset, and its row groups.
//!
//! The footer of a file is read on first use and kept. It locates each page of each column, so that only the pages of requested
//! rows are read.

use crate::error::{Error, Result};
use crate::row::{Batch, Row};
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::{
    ArrowReaderMetadata, ArrowReaderOptions, ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder,
    RowSelection, RowSelectionPolicy,
};
use parquet::file::metadata::PageIndexPolicy;
use parquet::file::reader::ChunkReader;
use std::fmt::Display;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Rows decoded at a time. This takes little memory even with large images.
const BATCH: usize = 32;

/// One Parquet file.
#[derive(Debug)]
pub(super) struct DataFile {
    path: PathBuf,
    /// Rows of the dataset in this file.
    pub(super) rows: Range<u64>,
    footer: OnceLock<ArrowReaderMetadata>,
}

impl DataFile {
    /// Creates a handle for a file without opening it.
    pub(super) fn new(path: PathBuf, rows: Range<u64>) -> Self {
        Self { path, rows, footer: OnceLock::new() }
    }

    /// Reads the footer on the first call.
    fn footer(&self) -> Result<&ArrowReaderMetadata> {
        if let Some(footer) = self.footer.get() {
            return Ok(footer);
        }
        let file = File::open(&self.path).map_err(Error::io(&self.path))?;
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

    /// Returns the row group of a row of this file.
    pub(super) fn group_of(&self, row: u64) -> Result<RowGroup<'_>> {
        let footer = self.footer()?;
        let mut end = self.rows.start;
        for (number, group) in footer.metadata().row_groups().iter().enumerate() {
            let start = end;
            end += group.num_rows() as u64;
            if row < end {
                return Ok(RowGroup { path: &self.path, footer, number, rows: start..end });
            }
        }
        Err(wrong_rows(&self.path, self.rows.end - self.rows.start, end - self.rows.start))
    }
}

/// A row group of a file: the rows read by one thread.
pub(super) struct RowGroup<'a> {
    pub(super) path: &'a Path,
    pub(super) footer: &'a ArrowReaderMetadata,
    /// Number in the file.
    number: usize,
    /// Rows of the dataset in this group.
    pub(super) rows: Range<u64>,
}

impl RowGroup<'_> {
    /// Reads some rows of the group, in ascending order.
    pub(super) fn read<R: Row>(&self, rows: &[u64]) -> Result<Vec<R>> {
        let Self { path, .. } = *self;
        let mut read = Vec::with_capacity(rows.len());
        for columns in self.open(rows.iter().map(|&row| row..row + 1), R::COLUMNS)? {
            let columns = &columns.map_err(|error| damaged(path, &error))?;
            read.extend(R::decode(&Batch::new(path, columns))?);
        }
        if read.len() == rows.len() { Ok(read) } else { Err(wrong_rows(path, rows.len(), read.len())) }
    }

    /// Opens the file for some rows of the group, in ascending order, and some columns.
    pub(super) fn open(
        &self,
        rows: impl Iterator<Item = Range<u64>>,
        columns: &[&str],
    ) -> Result<ParquetRecordBatchReader> {
        // Each group opens the file itself: threads that share an open file would move each other's position in it.
        let file = File::open(self.path).map_err(Error::io(self.path))?;
        self.select(file, rows, columns)
    }

    /// Selects rows and columns of an open file.
    pub(super) fn select<T: ChunkReader + 'static>(
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
            // A mask would also read the pages between the rows.
            .with_row_selection_policy(RowSelectionPolicy::Selectors)
            .with_projection(mask)
            .with_batch_size(BATCH);
        reader.build().map_err(|error| damaged(self.path, &error))
    }
}

/// Creates the error for a file that cannot be read as Parquet.
pub(super) fn damaged(path: &Path, error: &dyn std::error::Error) -> Error {
    Error::damaged(path, "a Parquet file written by flowservo", error)
}

/// Creates the error for a file with the wrong number of rows.
pub(super) fn wrong_rows(path: &Path, expected: impl Display, found: impl Display) -> Error {
    Error::damaged(path, format!("{expected} rows"), format!("{found} rows"))
}
