//! Differences between a stored value and the newly generated one.

use crate::row::png;
use arrow_array::Array;
use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float32Type, Float64Type, Int64Type, UInt64Type};
use serde::Serialize;
use std::fmt;

/// Difference between a stored value and the newly generated one.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Difference {
    /// The column is not stored.
    NotStored,
    /// The column is no longer generated.
    NotMade,
    /// Pixels differ.
    Pixels {
        /// Number of differing pixels.
        pixels: usize,
        /// Largest difference of a color channel, from 1 to 255.
        greatest: u8,
    },
    /// The pixels are equal, but the PNG files differ.
    Encoding,
    /// The image sizes differ.
    Size {
        /// Stored width and height \[pixels\].
        stored: [u32; 2],
        /// Generated width and height \[pixels\].
        made: [u32; 2],
    },
    /// Numbers differ.
    Numbers {
        /// Largest absolute difference, in the unit of the column; NaN if a number is NaN.
        greatest: f64,
    },
    /// Any other difference: text, type, list length, or an image that cannot be decoded.
    Other,
}

impl fmt::Display for Difference {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotStored => formatter.write_str("not stored"),
            Self::NotMade => formatter.write_str("no longer generated"),
            Self::Pixels { pixels, greatest } => {
                write!(formatter, "{pixels} pixels differ, by at most {greatest} of 255 per channel")
            }
            Self::Encoding => formatter.write_str("same pixels, different PNG encoding"),
            Self::Size { stored, made } => {
                let ([w, h], [width, height]) = (stored, made);
                write!(formatter, "stored as {w} x {h} pixels, generated as {width} x {height}")
            }
            Self::Numbers { greatest } => write!(formatter, "differs by at most {greatest:e}"),
            Self::Other => formatter.write_str("differs"),
        }
    }
}

/// Compares a column of one generated and one stored row. Returns `None` if they are bit-identical.
pub(super) fn difference(made: &dyn Array, stored: &dyn Array) -> Option<Difference> {
    if made == stored {
        return None;
    }
    let images = || Some(image_difference(png_of(made)?, png_of(stored)?));
    let numbers = || number_difference(&numbers_of(made)?, &numbers_of(stored)?);
    images().or_else(numbers).or(Some(Difference::Other))
}

fn image_difference(made: &[u8], stored: &[u8]) -> Difference {
    let (Ok(made_image), Ok(stored_image)) = (png::decode(made), png::decode(stored)) else {
        return Difference::Other;
    };
    if made_image.dimensions() != stored_image.dimensions() {
        let [stored, made] = [stored_image, made_image].map(|image| image.dimensions().into());
        return Difference::Size { stored, made };
    }
    let pairs = made_image.pixels().zip(stored_image.pixels());
    let apart = |(a, b): (&image::Rgb<u8>, &image::Rgb<u8>)| {
        a.0.iter().zip(&b.0).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
    };
    let apart: Vec<u8> = pairs.map(apart).filter(|&apart| apart > 0).collect();
    match apart.iter().max() {
        Some(&greatest) => Difference::Pixels { pixels: apart.len(), greatest },
        None if made != stored => Difference::Encoding,
        // The logical file names differ.
        None => Difference::Other,
    }
}

fn number_difference(made: &[f64], stored: &[f64]) -> Option<Difference> {
    let apart = made.iter().zip(stored).map(|(a, b)| (a - b).abs());
    // Unlike `f64::max`, this propagates NaN.
    let greatest = apart.fold(0.0, |max: f64, apart| if apart > max || apart.is_nan() { apart } else { max });
    (made.len() == stored.len()).then_some(Difference::Numbers { greatest })
}

/// Returns the PNG bytes in an image column of one row.
pub(super) fn png_of(column: &dyn Array) -> Option<&[u8]> {
    let bytes = column.as_struct_opt()?.column_by_name("bytes")?.as_binary_opt::<i32>()?;
    (bytes.len() == 1).then(|| bytes.value(0))
}

/// Returns the numbers in a column of one row.
fn numbers_of(column: &dyn Array) -> Option<Vec<f64>> {
    if let Some(lists) = column.as_fixed_size_list_opt() {
        return numbers_of(lists.values());
    }
    if let Some(doubles) = column.as_primitive_opt::<Float64Type>() {
        return Some(doubles.values().to_vec());
    }
    if let Some(floats) = column.as_primitive_opt::<Float32Type>() {
        return Some(floats.values().iter().copied().map(f64::from).collect());
    }
    if let Some(counts) = column.as_primitive_opt::<UInt64Type>() {
        return Some(counts.values().iter().map(|&count| count as f64).collect());
    }
    let classes = column.as_primitive_opt::<Int64Type>()?;
    Some(classes.values().iter().map(|&class| class as f64).collect())
}
