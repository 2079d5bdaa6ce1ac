//! Generates a row again and compares it with the stored one: every column, bit for bit.

use super::difference::{Difference, difference, png_of};
use super::reader::DatasetReader;
use crate::error::Result;
use crate::row::{Example, ExampleGenerator, encode};
use arrow_array::RecordBatch;
use serde::Serialize;

/// A row generated again, and its differences from the stored row.
#[derive(Debug, Clone)]
pub struct Replay {
    /// Row generated now.
    pub example: Example,
    /// All columns: the generated ones in order, then those that are only stored.
    pub columns: Vec<Comparison>,
    /// Image columns.
    pub images: Vec<ImagePair>,
}

/// Comparison of one column.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Name of the column.
    pub column: String,
    /// Difference, or `None` if the values are bit-identical.
    pub difference: Option<Difference>,
}

/// The generated and the stored image of a column.
#[derive(Debug, Clone)]
pub struct ImagePair {
    /// Name of the column.
    pub column: String,
    /// PNG generated now.
    pub made: Vec<u8>,
    /// Stored bytes, a PNG unless damaged.
    pub stored: Vec<u8>,
}

impl Replay {
    /// Returns the names of the columns that differ.
    pub fn differing(&self) -> Vec<&str> {
        let differing = self.columns.iter().filter(|comparison| comparison.difference.is_some());
        differing.map(|comparison| comparison.column.as_str()).collect()
    }
}

/// Generates a row again from the configuration in `dataset.json`, and compares it with the stored one.
pub fn replay(reader: &DatasetReader, row: u64) -> Result<Replay> {
    let stored = reader.record_batch(row)?;
    let generator = ExampleGenerator::new(&reader.info().config)?;
    let example = generator.example(row)?;
    let made = encode(&generator, std::slice::from_ref(&example))?;
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

fn pair(column: &str, made: &RecordBatch, stored: &RecordBatch) -> Option<ImagePair> {
    let bytes = |batch: &RecordBatch| Some(png_of(batch.column_by_name(column)?)?.to_vec());
    Some(ImagePair { column: column.to_owned(), made: bytes(made)?, stored: bytes(stored)? })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::DatasetConfig;
    use crate::digest::digest;
    use crate::error::Error;
    use crate::fixture::{config, make};
    use crate::row::{columns as columns_of, png};
    use crate::store::{FileRecord, Shard, publish_manifest};
    use parquet::arrow::ArrowWriter;
    use std::fs::{self, File};
    use std::path::Path;
    use tempfile::TempDir;

    /// Writes a dataset of two rows, the second of which is changed.
    fn changed(config: &DatasetConfig, change: &dyn Fn(&mut Example)) -> (TempDir, DatasetReader) {
        let dir = tempfile::tempdir().unwrap();
        let generator = ExampleGenerator::new(config).unwrap();
        let mut examples = [0, 1].map(|index| generator.example(index).unwrap());
        change(&mut examples[1]);
        let batch = encode(&generator, &examples).unwrap();
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
        publish_manifest(config, dir, files).unwrap();
        DatasetReader::open(dir).unwrap()
    }

    /// Returns the differing columns of row 1.
    fn found(name: &str, change: &dyn Fn(&mut Example)) -> Vec<(String, Difference)> {
        let (_dir, reader) = changed(&config(name, 2), change);
        assert_eq!(replay(&reader, 0).unwrap().differing(), [""; 0]);
        let columns = replay(&reader, 1).unwrap().columns;
        columns.into_iter().filter_map(|c| Some((c.column, c.difference?))).collect()
    }

    #[test]
    fn every_row_of_every_kind_is_reproduced() {
        for name in ["a", "b", "c", "avoid"] {
            let dir = tempfile::tempdir().unwrap();
            let config = config(name, 5);
            make(&config, dir.path()).unwrap();
            let reader = DatasetReader::open(dir.path()).unwrap();
            for row in 0..5 {
                let Replay { example, columns, images } = replay(&reader, row).unwrap();
                assert_eq!(columns.len(), columns_of(&config).len());
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
        assert_eq!(expected.to_string(), "3 pixels differ, by at most 40 of 255 per channel");
        assert_eq!(found("c", &paint), [("image_goal".to_owned(), expected)]);
    }

    #[test]
    fn another_encoding_of_the_same_pixels_is_recognized() {
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
        let destroy = |example: &mut Example| example.images[0] = b"not an image".to_vec();
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
    fn a_changed_scene_shows_in_everything_derived_from_it() {
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
        let generator = ExampleGenerator::new(&config).unwrap();
        let batch = encode(&generator, &[generator.example(0).unwrap()]).unwrap();
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
