//! Datasets in memory: images decoded once, at the size of the network's input, with their labels.

use std::ops::Range;
use std::path::PathBuf;

use datagen::row::Row;
use datagen::{ApproachRow, AvoidanceRow, DatasetReader};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use world::config::CameraConfig;

use crate::camera;
use crate::config::Task;
use crate::error::{Error, Result};
use crate::input::{self, decode};
use crate::net::DIRECTIONS;

/// Rows that are decoded at a time.
const CHUNK: usize = 256;

/// Where examples come from; recorded in the checkpoint.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Source {
    /// Name of the dataset.
    pub name: String,
    /// Digest of the dataset.
    pub digest: String,
    /// Number of examples.
    pub rows: usize,
}

/// All examples of all datasets of a training run.
#[derive(Debug, Clone)]
pub struct Examples {
    input: [usize; 2],
    camera: CameraConfig,
    /// `[example, image, height, width, 3]`.
    pixels: Vec<u8>,
    labels: Labels,
    sources: Vec<Source>,
}

/// One label an example.
#[derive(Debug, Clone)]
pub(crate) enum Labels {
    /// Metres and radians.
    PoseChanges(Vec<[f64; 6]>),
    /// Avoidance maps, one after the other.
    AvoidanceMaps(Vec<f32>),
}

impl Examples {
    /// Reads datasets and decodes their images in parallel. `progress` hears how many examples of how many are there.
    pub fn load(task: &Task, datasets: &[PathBuf], progress: &dyn Fn(usize, usize)) -> Result<Self> {
        let readers: Vec<_> =
            datasets.iter().map(|path| DatasetReader::open(path)).collect::<Result<_, _>>()?;
        let camera = common_camera(&readers)?;
        let rows = readers.iter().map(|reader| reader.info().rows as usize).sum();
        let mut examples = Self::empty(task, camera, rows);
        for reader in &readers {
            let (before, info) = (examples.len(), reader.info());
            if examples.sources.iter().any(|source| source.digest == info.digest) {
                let value = reader.dir().display().to_string();
                return Err(Error::Config { key: "datasets", value, expected: "each dataset once" });
            }
            examples.read(task, reader, &|done| progress(done, rows))?;
            let rows = examples.len() - before;
            examples.sources.push(Source { name: info.name.clone(), digest: info.digest.clone(), rows });
        }
        Ok(examples)
    }

    /// No examples yet, but memory for `rows`.
    fn empty(task: &Task, camera: CameraConfig, rows: usize) -> Self {
        let (images_each, labels) = match task {
            Task::Approach { .. } => (2, Labels::PoseChanges(Vec::with_capacity(rows))),
            Task::Avoidance { .. } => (1, Labels::AvoidanceMaps(Vec::with_capacity(rows * DIRECTIONS))),
        };
        let pixels = Vec::with_capacity(rows * images_each * input::bytes(task.input()));
        Self { input: task.input(), camera, pixels, labels, sources: Vec::new() }
    }

    fn read(&mut self, task: &Task, reader: &DatasetReader, progress: &dyn Fn(usize)) -> Result<()> {
        let input = self.input;
        match task {
            Task::Approach { label, .. } => decoded(
                reader,
                |row: &ApproachRow| {
                    let images =
                        [decode(&row.image_current, input)?, decode(&row.image_goal, input)?].concat();
                    Ok((images, label.label(&row.robot_from_current, &row.robot_from_goal).to_array()))
                },
                |(images, label)| {
                    self.push_pose_change(&images, label);
                    progress(self.len());
                },
            ),
            Task::Avoidance { .. } => decoded(
                reader,
                |row: &AvoidanceRow| {
                    if row.values.len() != DIRECTIONS {
                        return Err(format!("its map has {} directions, not {DIRECTIONS}", row.values.len()));
                    }
                    Ok((decode(&row.image, input)?, row.values.clone()))
                },
                |(image, map)| {
                    self.push_avoidance_map(&image, &map);
                    progress(self.len());
                },
            ),
        }
    }

    fn push_pose_change(&mut self, images: &[u8], label: [f64; 6]) {
        let Labels::PoseChanges(labels) = &mut self.labels else { panic!("examples of the other task") };
        labels.push(label);
        self.pixels.extend_from_slice(images);
    }

    fn push_avoidance_map(&mut self, image: &[u8], map: &[f32]) {
        let Labels::AvoidanceMaps(values) = &mut self.labels else { panic!("examples of the other task") };
        values.extend_from_slice(map);
        self.pixels.extend_from_slice(image);
    }

    /// Number of examples.
    pub fn len(&self) -> usize {
        match &self.labels {
            Labels::PoseChanges(labels) => labels.len(),
            Labels::AvoidanceMaps(values) => values.len() / DIRECTIONS,
        }
    }

    /// Are there no examples?
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Width and height of the images.
    pub fn input(&self) -> [usize; 2] {
        self.input
    }

    /// The camera that saw all images.
    pub fn camera(&self) -> &CameraConfig {
        &self.camera
    }

    /// The datasets, in their order.
    pub fn sources(&self) -> &[Source] {
        &self.sources
    }

    /// The numbers of each dataset's examples.
    pub fn ranges(&self) -> Vec<Range<usize>> {
        let mut end = 0;
        let range = |source: &Source| {
            let begin = end;
            end += source.rows;
            begin..end
        };
        self.sources.iter().map(range).collect()
    }

    pub(crate) fn labels(&self) -> &Labels {
        &self.labels
    }

    /// Images an example.
    pub(crate) fn images_each(&self) -> usize {
        match self.labels {
            Labels::PoseChanges(_) => 2,
            Labels::AvoidanceMaps(_) => 1,
        }
    }

    /// The pixels of an example's image 0 or 1.
    pub(crate) fn image(&self, index: usize, which: usize) -> &[u8] {
        let bytes = input::bytes(self.input);
        let begin = (index * self.images_each() + which) * bytes;
        &self.pixels[begin..begin + bytes]
    }
}

/// The camera of all datasets.
fn common_camera(readers: &[DatasetReader]) -> Result<CameraConfig> {
    let camera = |reader: &DatasetReader| reader.info().config.world.camera.clone();
    let common = camera(&readers[0]);
    for reader in &readers[1..] {
        if let Some((key, first_value, second_value)) = camera::difference(&common, &camera(reader)) {
            let [first, second] = [&readers[0], reader].map(|reader| reader.dir().to_owned());
            return Err(Error::CamerasDiffer { first, second, key, first_value, second_value });
        }
    }
    Ok(common)
}

/// Decodes the rows of a dataset in parallel, some at a time, and hands them on in their order.
fn decoded<R: Row + Send + Sync, T: Send>(
    reader: &DatasetReader,
    decode: impl Fn(&R) -> Result<T, String> + Sync,
    mut take: impl FnMut(T),
) -> Result<()> {
    let mut rows = reader.all::<R>()?;
    for first in (0..).step_by(CHUNK) {
        let chunk: Vec<R> = rows.by_ref().take(CHUNK).collect::<Result<_, _>>()?;
        if chunk.is_empty() {
            break;
        }
        let decode = |(i, row)| {
            let at = |problem| Error::Row { path: reader.dir().to_owned(), row: first + i, problem };
            decode(row).map_err(at)
        };
        let decoded: Vec<_> = chunk.par_iter().enumerate().map(decode).collect::<Result<_>>()?;
        decoded.into_iter().for_each(&mut take);
    }
    Ok(())
}

#[cfg(test)]
pub(crate) mod tests {
    use std::array::from_fn;
    use std::path::Path;
    use std::sync::atomic::AtomicBool;

    use datagen::{DatasetConfig, Kind, Options, generate};
    use tempfile::TempDir;
    use world::LabelForm;

    use super::*;
    use crate::config::tests::tiny;

    /// Examples whose images show a bright square on gray; the label is where it is, or where it went.
    pub(crate) fn squares(task: &Task, rows: usize) -> Examples {
        let camera = CameraConfig { width: 32, height: 24, horizontal_fov_deg: 60.0, behind_hand_mm: 100.0 };
        let mut examples = Examples::empty(task, camera, rows);
        for i in 0..rows {
            let (current, goal) = ([7 * i % 24, 5 * i % 16], [11 * i % 24, 3 * i % 16]);
            match task.kind() {
                Kind::Approach => {
                    let images = [square(current), square(goal)].concat();
                    let moved: [f64; 2] = from_fn(|axis| goal[axis] as f64 - current[axis] as f64);
                    examples.push_pose_change(&images, from_fn(|axis| 0.001 * moved[axis % 2]));
                }
                Kind::Avoidance => {
                    let map: [f32; DIRECTIONS] = from_fn(|n| if n % 24 < current[0] { 0.9 } else { 0.0 });
                    examples.push_avoidance_map(&square(current), &map);
                }
            }
        }
        examples.sources.push(Source { name: "squares".to_owned(), digest: format!("{rows}"), rows });
        examples
    }

    /// Examples of [`squares`] as if they were of two datasets.
    pub(crate) fn two_datasets(task: &Task, rows: [usize; 2]) -> Examples {
        let mut examples = squares(task, rows[0] + rows[1]);
        let source = |rows| Source { name: format!("squares {rows}"), digest: format!("{rows}"), rows };
        examples.sources = rows.map(source).to_vec();
        examples
    }

    impl Examples {
        /// The same, seen by a camera of another field of view.
        pub(crate) fn seen_at(mut self, fov_deg: f64) -> Self {
            self.camera.horizontal_fov_deg = fov_deg;
            self
        }
    }

    /// 32 x 24 pixels.
    fn square([left, top]: [usize; 2]) -> Vec<u8> {
        let inside = |i: usize| (left..left + 8).contains(&(i % 32)) && (top..top + 8).contains(&(i / 32));
        (0..32 * 24).flat_map(|i| if inside(i) { [250, 240, 10] } else { [90; 3] }).collect()
    }

    /// Generates a dataset of four rows by a file of `configs/datasets`, seen by a camera of this field of view.
    fn dataset(name: &str, fov_deg: f64) -> TempDir {
        let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
        let table = |file: &str| -> toml::Table {
            std::fs::read_to_string(configs.join(file)).unwrap().parse().unwrap()
        };
        let mut config = table(&format!("datasets/{name}.toml"));
        config.insert("world".to_owned(), table("world.toml").into());
        let mut config = DatasetConfig::from_table(config).unwrap();
        (config.count, config.rows_per_shard) = (4, 3);
        (config.world.camera.width, config.world.camera.height) = (64, 48);
        config.world.camera.horizontal_fov_deg = fov_deg;
        let directory = tempfile::tempdir().unwrap();
        generate(&config, directory.path(), &Options { stop: &AtomicBool::new(false) }, &|_| {}).unwrap();
        directory
    }

    fn load(kind: Kind, datasets: &[&TempDir]) -> Result<Examples> {
        let paths: Vec<_> = datasets.iter().map(|directory| directory.path().to_owned()).collect();
        Examples::load(&tiny(kind).task().unwrap(), &paths, &|done, of| assert!(done <= of))
    }

    #[test]
    fn datasets_become_examples_in_their_order() {
        let [a, b] = [dataset("a", 60.0), dataset("b", 60.0)];
        let examples = load(Kind::Approach, &[&a, &b]).unwrap();
        assert_eq!((examples.len(), examples.ranges()), (8, vec![0..4, 4..8]));
        let rows = DatasetReader::open(b.path()).unwrap().all::<ApproachRow>().unwrap();
        let Labels::PoseChanges(labels) = examples.labels() else { panic!("not pose changes") };
        for (i, row) in (4..).zip(rows) {
            let row = row.unwrap();
            let label = LabelForm::Twist.label(&row.robot_from_current, &row.robot_from_goal);
            assert_eq!(labels[i].map(f64::to_bits), label.to_array().map(f64::to_bits));
            assert_eq!(examples.image(i, 0), decode(&row.image_current, [32, 24]).unwrap());
            assert_eq!(examples.image(i, 1), decode(&row.image_goal, [32, 24]).unwrap());
        }
    }

    #[test]
    fn maps_become_examples_and_pairs_do_not() {
        let avoid = dataset("avoid", 60.0);
        let examples = load(Kind::Avoidance, &[&avoid]).unwrap();
        let rows = DatasetReader::open(avoid.path()).unwrap().all::<AvoidanceRow>().unwrap();
        let expected: Vec<f32> = rows.flat_map(|row| row.unwrap().values).collect();
        let Labels::AvoidanceMaps(values) = examples.labels() else { panic!("not maps") };
        assert_eq!(values, &expected);
        let error = load(Kind::Approach, &[&avoid]).unwrap_err().to_string();
        assert!(error.contains("avoidance") && error.contains("approach"), "{error}");
    }

    #[test]
    fn datasets_that_do_not_fit_together_are_named() {
        let [a, b] = [dataset("a", 60.0), dataset("b", 75.0)];
        let error = load(Kind::Approach, &[&a, &b]).unwrap_err().to_string();
        assert!(error.contains("horizontal_fov_deg: 60 and 75"), "{error}");
        assert!([&a, &b].iter().all(|dataset| error.contains(dataset.path().to_str().unwrap())), "{error}");
        let error = load(Kind::Approach, &[&a, &a]).unwrap_err().to_string();
        assert!(error.contains("each dataset once"), "{error}");
    }
}
