//! The images of a dataset at the size of a network's input, decoded on demand.

use datagen::{DatasetReader, ImagesRow};
use rayon::prelude::*;

use super::input::{self, decode};
use crate::error::{Error, Result};

/// The encoded images of one dataset.
#[derive(Debug, Clone)]
pub(crate) struct ImageStream {
    reader: DatasetReader,
    /// Width and height of the decoded images.
    pub(crate) input: [usize; 2],
    /// Images per example.
    pub(crate) images_each: usize,
}

impl ImageStream {
    pub(crate) fn new(reader: &DatasetReader, input: [usize; 2], images_each: usize) -> Self {
        Self { reader: reader.clone(), input, images_each }
    }

    pub(crate) fn reader(&self) -> &DatasetReader {
        &self.reader
    }

    /// Returns the bytes of an example's pixels.
    pub(crate) fn example_len(&self) -> usize {
        self.images_each * input::bytes(self.input)
    }

    /// Reads and decodes examples in parallel. Returns the pixels of each: those of its images, one after the other.
    pub(crate) fn pixels(&self, examples: &[u64]) -> Result<Vec<Vec<u8>>> {
        let rows: Vec<ImagesRow> = self.reader.rows_at(examples)?;
        let decoded: Vec<_> = rows.par_iter().map(|row| self.decoded(row)).collect();
        decoded.into_iter().collect()
    }

    fn decoded(&self, row: &ImagesRow) -> Result<Vec<u8>> {
        let at = |problem| {
            let path = self.reader.dir().to_owned();
            Error::Row { path, row: row.index as usize, problem }
        };
        if row.images.len() != self.images_each {
            return Err(at(format!("{} images instead of {}", row.images.len(), self.images_each)));
        }
        let images = row.images.iter().map(|png| decode(png, self.input));
        Ok(images.collect::<Result<Vec<_>, _>>().map_err(at)?.concat())
    }
}
