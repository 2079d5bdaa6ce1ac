//! Makes a row again and compares it with what is stored, column by column: every byte of an image and every bit of a number.

use crate::error::Result;
use crate::example::{Collector, Example};
use crate::png;
use crate::reader::DatasetReader;
use crate::schema;
use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float32Type, Float64Type, Int64Type, UInt64Type};
use arrow_array::{Array, RecordBatch};
use serde::Serialize;
use std::fmt;

/// A row as it is made now, and how what is stored differs from it.
#[derive(Debug, Clone)]
pub struct Replay {
    /// The row as it is made now.
    pub example: Example,
    /// All columns: those that are made now, in their order, then those that are only stored.
    pub columns: Vec<Comparison>,
    /// The columns with images.
    pub images: Vec<ImagePair>,
}

/// What became of a column.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Name of the column.
    pub column: String,
    /// How what is stored differs; none if it is the same to the bit.
    pub difference: Option<Difference>,
}

/// How a stored value differs from the one that is made now.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Difference {
    /// No such column is stored.
    NotStored,
    /// No such column is made.
    NotMade,
    /// Other pixels.
    Pixels {
        /// How many, of the whole image.
        pixels: usize,
        /// The greatest difference of a color channel, from 1 to 255.
        greatest: u8,
    },
    /// The same pixels in another PNG.
    Encoding,
    /// An image of another size.
    Size {
        /// Stored width and height \[pixels\].
        stored: [u32; 2],
        /// Width and height of what is made now.
        made: [u32; 2],
    },
    /// Other numbers, as many.
    Numbers {
        /// The greatest absolute difference, in the column's unit; NaN if one is stored.
        greatest: f64,
    },
    /// Something else: a text, a type, a number of numbers, an image that cannot be decoded.
    Other,
}

/// An image, twice.
#[derive(Debug, Clone)]
pub struct ImagePair {
    /// Name of the column.
    pub column: String,
    /// PNG as it is made now.
    pub made: Vec<u8>,
    /// What is stored, a PNG if nothing is wrong with it.
    pub stored: Vec<u8>,
}

impl Replay {
    /// Names of the columns that differ.
    pub fn differing(&self) -> Vec<&str> {
        let differing = self.columns.iter().filter(|comparison| comparison.difference.is_some());
        differing.map(|comparison| comparison.column.as_str()).collect()
    }
}

/// Makes a row of a dataset again from the configuration in `dataset.json`.
pub fn replay(reader: &DatasetReader, row: u64) -> Result<Replay> {
    let stored = reader.record(row)?;
    let collector = Collector::new(&reader.info().config)?;
    let example = collector.example(row)?;
    let made = schema::encode(&collector, std::slice::from_ref(&example))?;
    let images =
        made.schema().fields().iter().filter_map(|field| pair(field.name(), &made, &stored)).collect();
    Ok(Replay { example, columns: compare(&made, &stored), images })
}

fn compare(made: &RecordBatch, stored: &RecordBatch) -> Vec<Comparison> {
    let (made_columns, stored_columns) = (made.schema(), stored.schema());
    let made_columns = made_columns.fields().iter().zip(made.columns()).map(|(field, made)| Comparison {
        column: field.name().clone(),
        difference: match stored.column_by_name(field.name()) {
            Some(stored) => difference(made, stored),
            None => Some(Difference::NotStored),
        },
    });
    let stored_columns =
        stored_columns.fields().iter().filter(|field| made.column_by_name(field.name()).is_none());
    let only_stored =
        |column: &str| Comparison { column: column.to_owned(), difference: Some(Difference::NotMade) };
    made_columns.chain(stored_columns.map(|field| only_stored(field.name()))).collect()
}

fn difference(made: &dyn Array, stored: &dyn Array) -> Option<Difference> {
    if made == stored {
        return None;
    }
    let images = || Some(of_images(png_of(made)?, png_of(stored)?));
    let numbers = || of_numbers(&numbers_of(made)?, &numbers_of(stored)?);
    images().or_else(numbers).or(Some(Difference::Other))
}

fn of_images(made: &[u8], stored: &[u8]) -> Difference {
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
        // What differs is the logical name of the file.
        None => Difference::Other,
    }
}

fn of_numbers(made: &[f64], stored: &[f64]) -> Option<Difference> {
    let apart = made.iter().zip(stored).map(|(a, b)| (a - b).abs());
    // Unlike `f64::max`, this keeps NaN.
    let greatest = apart.fold(0.0, |max: f64, apart| if apart > max || apart.is_nan() { apart } else { max });
    (made.len() == stored.len()).then_some(Difference::Numbers { greatest })
}

/// The bytes of the image in a column of one row.
fn png_of(column: &dyn Array) -> Option<&[u8]> {
    let bytes = column.as_struct_opt()?.column_by_name("bytes")?.as_binary_opt::<i32>()?;
    (bytes.len() == 1).then(|| bytes.value(0))
}

/// The numbers in a column of one row.
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

fn pair(column: &str, made: &RecordBatch, stored: &RecordBatch) -> Option<ImagePair> {
    let bytes = |batch: &RecordBatch| Some(png_of(batch.column_by_name(column)?)?.to_vec());
    Some(ImagePair { column: column.to_owned(), made: bytes(made)?, stored: bytes(stored)? })
}

impl fmt::Display for Difference {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotStored => formatter.write_str("not stored"),
            Self::NotMade => formatter.write_str("not made any more"),
            Self::Pixels { pixels, greatest } => {
                write!(formatter, "{pixels} pixels differ, a channel by {greatest} of 255 at most")
            }
            Self::Encoding => formatter.write_str("other PNG bytes, the same pixels"),
            Self::Size { stored, made } => {
                let ([w, h], [width, height]) = (stored, made);
                write!(formatter, "stored with {w} x {h} pixels, made with {width} x {height}")
            }
            Self::Numbers { greatest } => write!(formatter, "differs by {greatest:e} at most"),
            Self::Other => formatter.write_str("differs"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DatasetConfig;
    use crate::error::Error;
    use crate::info::{DatasetInfo, FileRecord};
    use crate::publish::digest;
    use crate::shard::Shard;
    use crate::tiny::{config, make};
    use parquet::arrow::ArrowWriter;
    use std::fs::{self, File};
    use std::path::Path;
    use tempfile::TempDir;

    /// A dataset of two rows whose second was changed.
    fn changed(config: &DatasetConfig, change: &dyn Fn(&mut Example)) -> (TempDir, DatasetReader) {
        let dir = tempfile::tempdir().unwrap();
        let collector = Collector::new(config).unwrap();
        let mut examples = [0, 1].map(|index| collector.example(index).unwrap());
        change(&mut examples[1]);
        let batch = schema::encode(&collector, &examples).unwrap();
        let reader = stored(config, dir.path(), &batch);
        (dir, reader)
    }

    /// Writes rows as the only file of a dataset.
    fn stored(config: &DatasetConfig, dir: &Path, batch: &RecordBatch) -> DatasetReader {
        let path = Shard::all(config)[0].path();
        fs::create_dir(dir.join("data")).unwrap();
        let file = File::create(dir.join(&path)).unwrap();
        let mut writer = ArrowWriter::try_new(file, batch.schema(), None).unwrap();
        writer.write(batch).unwrap();
        writer.close().unwrap();
        let bytes = fs::read(dir.join(&path)).unwrap();
        let (sha256, length) = (digest(&bytes), bytes.len() as u64);
        let files = vec![FileRecord { path, sha256, rows: config.count, bytes: length }];
        DatasetInfo::new(config, files).unwrap().publish(dir).unwrap();
        DatasetReader::open(dir).unwrap()
    }

    /// The columns of row 1 that differ, and how.
    fn found(name: &str, change: &dyn Fn(&mut Example)) -> Vec<(String, Difference)> {
        let (_dir, reader) = changed(&config(name, 2), change);
        assert_eq!(replay(&reader, 0).unwrap().differing(), [""; 0]);
        let columns = replay(&reader, 1).unwrap().columns;
        columns.into_iter().filter_map(|c| Some((c.column, c.difference?))).collect()
    }

    #[test]
    fn every_row_of_every_kind_is_made_again() {
        for name in ["a", "b", "c", "avoid"] {
            let dir = tempfile::tempdir().unwrap();
            let config = config(name, 5);
            make(&config, dir.path()).unwrap();
            let reader = DatasetReader::open(dir.path()).unwrap();
            for row in 0..5 {
                let Replay { example, columns, images } = replay(&reader, row).unwrap();
                assert_eq!(columns.len(), schema::columns(&config).len());
                assert!(
                    columns.iter().all(|column| column.difference.is_none()),
                    "{name} {row}: {columns:?}"
                );
                assert_eq!(example.index, row);
                assert_eq!(images.len(), if name == "avoid" { 1 } else { 2 });
                assert!(images.iter().all(|image| image.made == image.stored));
            }
            assert!(matches!(replay(&reader, 5), Err(Error::OutOfRange { rows: 5, .. })));
        }
    }

    #[test]
    fn changed_pixels_are_counted() {
        let paint = |example: &mut Example| {
            let mut image = png::decode(&example.images[1]).unwrap();
            for (x, by) in [(3, 1), (7, 40), (20, 2)] {
                let channel = &mut image.get_pixel_mut(x, 11).0[1];
                *channel = if *channel > 100 { *channel - by } else { *channel + by };
            }
            example.images[1] = png::encode(&image).unwrap();
        };
        let expected = Difference::Pixels { pixels: 3, greatest: 40 };
        assert_eq!(expected.to_string(), "3 pixels differ, a channel by 40 of 255 at most");
        assert_eq!(found("c", &paint), [("image_goal".to_owned(), expected)]);
    }

    #[test]
    fn another_encoding_of_the_same_pixels_is_told_apart() {
        let encode = |example: &mut Example| {
            let image = png::decode(&example.images[0]).unwrap();
            let mut bytes = std::io::Cursor::new(Vec::new());
            image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
            assert_ne!(&example.images[0], bytes.get_ref());
            example.images[0] = bytes.into_inner();
        };
        assert_eq!(found("avoid", &encode), [("image".to_owned(), Difference::Encoding)]);
        let crop = |example: &mut Example| {
            let image = image::RgbImage::new(31, 24);
            example.images[0] = png::encode(&image).unwrap();
        };
        let expected = Difference::Size { stored: [31, 24], made: [32, 24] };
        assert_eq!(found("avoid", &crop), [("image".to_owned(), expected)]);
        let destroy = |example: &mut Example| example.images[0] = b"no image".to_vec();
        assert_eq!(found("avoid", &destroy), [("image".to_owned(), Difference::Other)]);
    }

    #[test]
    fn changed_numbers_are_named_with_their_difference() {
        let move_joint = |example: &mut Example| example.placement.hands[0].joints[2] += 0.25;
        let columns = found("a", &move_joint);
        let [(column, Difference::Numbers { greatest })] = &columns[..] else { panic!("{columns:?}") };
        assert_eq!(column, "joints_current");
        assert!((greatest - 0.25).abs() < 1e-12, "{greatest}");
        let smallest = |example: &mut Example| {
            let angle = &mut example.placement.hands[0].joints[2];
            *angle = f64::from_bits(angle.to_bits() + 1);
        };
        assert_eq!(found("a", &smallest).len(), 1);
        let block = |example: &mut Example| {
            example.avoidance[7] = f32::NAN;
            example.avoidance[90] += 0.5;
        };
        let columns = found("avoid", &block);
        assert!(
            matches!(&columns[..], [(column, Difference::Numbers { greatest })] if column == "values" && greatest.is_nan()),
            "{columns:?}"
        );
        let motion = |example: &mut Example| example.placement.motion = 1 - example.placement.motion;
        assert_eq!(found("b", &motion), [("motion".to_owned(), Difference::Numbers { greatest: 1.0 })]);
    }

    #[test]
    fn a_changed_scene_shows_in_all_that_is_derived_from_it() {
        let remove = |example: &mut Example| example.placement.scene.obstacles.truncate(0);
        let columns = found("c", &remove);
        assert!(
            matches!(&columns[0], (column, Difference::Numbers { greatest: 1.0.. }) if column == "obstacles")
        );
        assert_eq!(columns[1..], [("scene".to_owned(), Difference::Other)]);
    }

    #[test]
    fn columns_of_another_version_are_named() {
        let config = config("a", 1);
        let collector = Collector::new(&config).unwrap();
        let batch = schema::encode(&collector, &[collector.example(0).unwrap()]).unwrap();
        let of = |names: &[&str]| -> Vec<Comparison> {
            let dir = tempfile::tempdir().unwrap();
            let indices: Vec<_> = names.iter().map(|name| batch.schema().index_of(name).unwrap()).collect();
            let reader = stored(&config, dir.path(), &batch.project(&indices).unwrap());
            replay(&reader, 0).unwrap().columns
        };
        let few = of(&["index", "seed"]);
        assert_eq!(few[1], Comparison { column: "seed".to_owned(), difference: None });
        assert_eq!(few[2].difference, Some(Difference::NotStored));
        let only_stored = compare(&batch.project(&[0]).unwrap(), &batch.project(&[0, 1]).unwrap());
        assert_eq!(
            only_stored[1],
            Comparison { column: "seed".to_owned(), difference: Some(Difference::NotMade) }
        );
    }
}
