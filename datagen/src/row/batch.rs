//! Typed access to the columns of a record batch.

use crate::error::{Error, Result};
use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float32Type, Float64Type, Int64Type, UInt64Type};
use arrow_array::{
    Array, BinaryArray, FixedSizeListArray, Int64Array, RecordBatch, StringArray, UInt64Array,
};
use nalgebra::Vector3;
use std::path::Path;
use world::pose::HandPose;

/// Some rows of a file. Accessors check that a column has its published type and no nulls.
pub struct Batch<'a> {
    path: &'a Path,
    columns: &'a RecordBatch,
}

impl<'a> Batch<'a> {
    /// Wraps rows of a file. The path is for error messages.
    pub(crate) fn new(path: &'a Path, columns: &'a RecordBatch) -> Self {
        Self { path, columns }
    }

    /// Returns the number of rows.
    pub(crate) fn rows(&self) -> usize {
        self.columns.num_rows()
    }

    /// Returns whether the batch has a column.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.columns.column_by_name(name).is_some()
    }

    /// Returns a column of unsigned integers.
    pub(crate) fn counts(&self, name: &str) -> Result<&UInt64Array> {
        self.column(name)?.as_primitive_opt::<UInt64Type>().ok_or_else(|| self.wrong(name))
    }

    /// Returns a column of class labels.
    pub(crate) fn classes(&self, name: &str) -> Result<&Int64Array> {
        self.column(name)?.as_primitive_opt::<Int64Type>().ok_or_else(|| self.wrong(name))
    }

    /// Returns a column of strings.
    pub(crate) fn texts(&self, name: &str) -> Result<&StringArray> {
        self.column(name)?.as_string_opt::<i32>().ok_or_else(|| self.wrong(name))
    }

    /// Returns the bytes of a column of images.
    pub(super) fn images(&self, name: &str) -> Result<&BinaryArray> {
        let bytes = self.column(name)?.as_struct_opt().and_then(|image| image.column_by_name("bytes"));
        bytes.and_then(|bytes| bytes.as_binary_opt::<i32>()).ok_or_else(|| self.wrong(name))
    }

    /// Returns a column of hand poses.
    pub(super) fn poses(&self, name: &str) -> Result<Vec<HandPose>> {
        let pose = |v: [f64; 6]| HandPose {
            position: Vector3::new(v[0], v[1], v[2]),
            angles: Vector3::new(v[3], v[4], v[5]),
        };
        Ok(self.doubles(name)?.into_iter().map(pose).collect())
    }

    /// Returns a column of N numbers in double precision.
    pub(crate) fn doubles<const N: usize>(&self, name: &str) -> Result<Vec<[f64; N]>> {
        let numbers = self.lists(name)?.values().as_primitive_opt::<Float64Type>();
        let (rows, rest) = numbers.ok_or_else(|| self.wrong(name))?.values().as_chunks();
        let fits = rest.is_empty() && rows.len() == self.rows();
        if fits { Ok(rows.to_vec()) } else { Err(self.wrong(name)) }
    }

    /// Returns a column of avoidance maps.
    pub(crate) fn maps(&self, name: &str) -> Result<Vec<&[f32]>> {
        let lists = self.lists(name)?;
        let numbers = lists.values().as_primitive_opt::<Float32Type>().ok_or_else(|| self.wrong(name))?;
        Ok(numbers.values().chunks_exact(lists.value_length().max(1) as usize).collect())
    }

    fn lists(&self, name: &str) -> Result<&FixedSizeListArray> {
        self.column(name)?.as_fixed_size_list_opt().ok_or_else(|| self.wrong(name))
    }

    fn column(&self, name: &str) -> Result<&dyn Array> {
        let column = self.columns.column_by_name(name).filter(|column| column.null_count() == 0);
        column.map(AsRef::as_ref).ok_or_else(|| self.wrong(name))
    }

    /// Creates the error for a missing or foreign column.
    pub(crate) fn wrong(&self, name: &str) -> Error {
        let found = match self.columns.column_by_name(name) {
            Some(column) => {
                format!("values of type {} with {} nulls", column.data_type(), column.null_count())
            }
            None => "no such column".to_owned(),
        };
        Error::damaged(self.path, format!("column {name} as written by flowservo"), found)
    }
}
