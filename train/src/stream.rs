//! The images of a dataset at the size of a network's input, decoded when they are asked for.

use datagen::DatasetReader;
use datagen::row::ImagesRow;
use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::input::{self, decode};

/// The images of one dataset, encoded.
#[derive(Debug, Clone)]
pub(crate) struct ImageStream {
    reader: DatasetReader,
    /// Width and height of the decoded images.
    pub(crate) input: [usize; 2],
    pub(crate) images_each: usize,
}

impl ImageStream {
    pub(crate) fn new(reader: &DatasetReader, input: [usize; 2], images_each: usize) -> Self {
        Self { reader: reader.clone(), input, images_each }
    }

    pub(crate) fn reader(&self) -> &DatasetReader {
        &self.reader
    }

    /// Bytes of an example's pixels.
    pub(crate) fn example(&self) -> usize {
        self.images_each * input::bytes(self.input)
    }

    /// The pixels of examples, those of all images of an example one after the other. They are read and decoded in parallel.
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
            return Err(at(format!("it has {} images, not {}", row.images.len(), self.images_each)));
        }
        let images = row.images.iter().map(|png| decode(png, self.input));
        Ok(images.collect::<Result<Vec<_>, _>>().map_err(at)?.concat())
    }
}
