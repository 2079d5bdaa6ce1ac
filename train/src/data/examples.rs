//! The examples of a training run: images at the size of the network's input, and labels. Labels are held in memory. Images
//! come from a cache or are decoded for each batch.

use std::borrow::Cow;
use std::ops::Range;
use std::path::{Path, PathBuf};

use datagen::{ApproachRow, AvoidanceRow, DatasetReader};
use serde::{Deserialize, Serialize};
use world::config::CameraConfig;

use super::camera;
use super::image_cache::ImageCache;
use super::image_stream::ImageStream;
use crate::config::ImageSource;
use crate::error::{Error, Result};
use crate::network::avoid::DIRECTIONS;
use crate::network::task::Task;

/// A dataset of a training run, as recorded in checkpoints.
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
#[derive(Debug)]
pub struct Examples {
    input: [usize; 2],
    camera: CameraConfig,
    /// Images of each dataset.
    images: Vec<DatasetImages>,
    labels: Labels,
    sources: Vec<Source>,
}

/// The images of one dataset at the size of the network's input.
#[derive(Debug)]
enum DatasetImages {
    Cached(ImageCache),
    Streamed(ImageStream),
}

impl DatasetImages {
    /// Returns the pixels of each example: those of its images, one after the other.
    fn pixels(&self, examples: &[u64]) -> Result<Vec<Cow<'_, [u8]>>> {
        Ok(match self {
            Self::Cached(cache) => examples.iter().map(|&i| cache.pixels(i).into()).collect(),
            Self::Streamed(stream) => stream.pixels(examples)?.into_iter().map(Cow::from).collect(),
        })
    }
}

/// The labels of all examples.
#[derive(Debug)]
pub(crate) enum Labels {
    /// Pose changes in meters and radians.
    PoseChanges(Vec<[f64; 6]>),
    /// Concatenated avoidance maps.
    AvoidanceMaps(Vec<f32>),
}

impl Examples {
    /// Reads the labels of datasets and opens their images. Images to be cached are decoded now, in parallel, unless they
    /// are cached already. `progress` receives the number of finished examples and the number of all examples.
    pub fn load(
        task: &Task,
        source: ImageSource,
        datasets: &[PathBuf],
        progress: &dyn Fn(usize, usize),
    ) -> Result<Self> {
        let readers: Vec<_> =
            datasets.iter().map(|path| DatasetReader::open(path)).collect::<Result<_, _>>()?;
        let camera = common_camera(&readers)?;
        let rows = readers.iter().map(|reader| reader.info().rows as usize).sum();
        let mut examples = Self::empty(task, camera);
        for reader in &readers {
            let (before, info) = (examples.len(), reader.info());
            if examples.sources.iter().any(|source| source.digest == info.digest) {
                let value = reader.dir().display().to_string();
                return Err(Error::Config { key: "datasets", value, expected: "each dataset once" });
            }
            examples.read_labels(task, reader)?;
            let decoded = |done| progress(before + done, rows);
            let stream = ImageStream::new(reader, examples.input, examples.images_each());
            examples.images.push(match source {
                ImageSource::Cache => DatasetImages::Cached(ImageCache::open(&stream, &decoded)?),
                ImageSource::Stream => {
                    // Detects images that do not fit before training starts.
                    stream.pixels(&[0])?;
                    DatasetImages::Streamed(stream)
                }
            });
            let rows = examples.len() - before;
            examples.sources.push(Source { name: info.name.clone(), digest: info.digest.clone(), rows });
        }
        progress(rows, rows);
        Ok(examples)
    }

    /// Returns a collection without examples.
    fn empty(task: &Task, camera: CameraConfig) -> Self {
        let labels = match task {
            Task::Approach { .. } => Labels::PoseChanges(Vec::new()),
            Task::Avoidance { .. } => Labels::AvoidanceMaps(Vec::new()),
        };
        Self { input: task.input(), camera, images: Vec::new(), labels, sources: Vec::new() }
    }

    fn read_labels(&mut self, task: &Task, reader: &DatasetReader) -> Result<()> {
        match (task, &mut self.labels) {
            (Task::Approach { label, .. }, Labels::PoseChanges(labels)) => {
                for row in reader.all::<ApproachRow>()? {
                    let ApproachRow { robot_from_current, robot_from_goal, .. } = row?;
                    labels.push(label.label(&robot_from_current, &robot_from_goal).to_array());
                }
            }
            (Task::Avoidance { .. }, Labels::AvoidanceMaps(maps)) => {
                for row in reader.all::<AvoidanceRow>()? {
                    let AvoidanceRow { index, values, .. } = row?;
                    if values.len() != DIRECTIONS {
                        let problem = format!(
                            "an avoidance map of {} directions instead of {DIRECTIONS}",
                            values.len()
                        );
                        return Err(Error::Row {
                            path: reader.dir().to_owned(),
                            row: index as usize,
                            problem,
                        });
                    }
                    maps.extend(values);
                }
            }
            _ => unreachable!("made for the same task"),
        }
        Ok(())
    }

    /// Returns the number of examples.
    pub fn len(&self) -> usize {
        match &self.labels {
            Labels::PoseChanges(labels) => labels.len(),
            Labels::AvoidanceMaps(values) => values.len() / DIRECTIONS,
        }
    }

    /// Returns whether there are no examples.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns width and height of the images.
    pub fn input(&self) -> [usize; 2] {
        self.input
    }

    /// Returns the camera of all images.
    pub fn camera(&self) -> &CameraConfig {
        &self.camera
    }

    /// Returns the datasets in order.
    pub fn sources(&self) -> &[Source] {
        &self.sources
    }

    /// Returns the cache file of each dataset: in its folder, or in a temporary folder of the user if that is not writable.
    /// Streamed datasets have none.
    pub fn caches(&self) -> impl Iterator<Item = &Path> {
        self.images.iter().filter_map(|images| match images {
            DatasetImages::Cached(cache) => Some(cache.path()),
            DatasetImages::Streamed(_) => None,
        })
    }

    /// Returns the indices of each dataset's examples.
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

    /// Returns the images per example.
    pub(crate) fn images_each(&self) -> usize {
        match self.labels {
            Labels::PoseChanges(_) => 2,
            Labels::AvoidanceMaps(_) => 1,
        }
    }

    /// Returns the pixels of examples, in the given order: for each those of its images, one after the other.
    pub(crate) fn pixels(&self, indices: &[usize]) -> Result<Vec<Cow<'_, [u8]>>> {
        let mut pixels = vec![Cow::Borrowed(&[][..]); indices.len()];
        for (range, images) in self.ranges().iter().zip(&self.images) {
            let inside = indices.iter().enumerate().filter(|(_, index)| range.contains(index));
            let (places, rows): (Vec<_>, Vec<_>) =
                inside.map(|(place, index)| (place, (index - range.start) as u64)).unzip();
            for (place, found) in places.into_iter().zip(images.pixels(&rows)?) {
                pixels[place] = found;
            }
        }
        Ok(pixels)
    }
}

/// Returns the camera that all datasets share.
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

#[cfg(test)]
pub(crate) mod tests {
    use std::array::from_fn;
    use std::sync::atomic::AtomicBool;

    use datagen::{DatasetConfig, ImagesRow, Kind, Options, generate};
    use tempfile::TempDir;
    use world::LabelForm;

    use super::*;
    use crate::config::tests::tiny;
    use crate::data::image_cache::tests::{destroy_images, in_memory};
    use crate::data::input::decode;

    /// Returns examples that show a bright square on gray. The label is its position, or its motion.
    pub(crate) fn squares(task: &Task, rows: usize) -> Examples {
        let camera = CameraConfig { width: 32, height: 24, horizontal_fov_deg: 60.0, behind_hand_mm: 100.0 };
        let mut examples = Examples::empty(task, camera);
        let mut pixels = Vec::new();
        for i in 0..rows {
            let (current, goal) = ([7 * i % 24, 5 * i % 16], [11 * i % 24, 3 * i % 16]);
            pixels.extend(square(current));
            match &mut examples.labels {
                Labels::PoseChanges(labels) => {
                    pixels.extend(square(goal));
                    let moved: [f64; 2] = from_fn(|axis| goal[axis] as f64 - current[axis] as f64);
                    labels.push(from_fn(|axis| 0.001 * moved[axis % 2]));
                }
                Labels::AvoidanceMaps(values) => {
                    values.extend((0..DIRECTIONS).map(|n| if n % 24 < current[0] { 0.9 } else { 0.0 }));
                }
            }
        }
        examples.images.push(DatasetImages::Cached(in_memory(&pixels, pixels.len() / rows)));
        examples.sources.push(Source { name: "squares".to_owned(), digest: format!("{rows}"), rows });
        examples
    }

    /// Returns the examples of [`squares`] divided into two datasets.
    pub(crate) fn two_datasets(task: &Task, rows: [usize; 2]) -> Examples {
        let mut examples = squares(task, rows[0] + rows[1]);
        let pixels = examples.pixels(&(0..examples.len()).collect::<Vec<_>>()).unwrap();
        let parts = [&pixels[..rows[0]], &pixels[rows[0]..]]
            .map(|pixels| in_memory(&pixels.concat(), pixels[0].len()));
        examples.images = parts.map(DatasetImages::Cached).into();
        examples.sources.clear();
        for rows in rows {
            examples.sources.push(Source {
                name: format!("squares {rows}"),
                digest: format!("{rows}"),
                rows,
            });
        }
        examples
    }

    impl Examples {
        /// Replaces a label by NaN.
        pub(crate) fn with_a_label_missing(mut self) -> Self {
            let Labels::PoseChanges(labels) = &mut self.labels else { panic!("not pose changes") };
            labels[0][0] = f64::NAN;
            self
        }

        /// Changes the field of view of the camera.
        pub(crate) fn seen_at(mut self, fov_deg: f64) -> Self {
            self.camera.horizontal_fov_deg = fov_deg;
            self
        }
    }

    /// Draws a square, 32 x 24 pixels.
    fn square([left, top]: [usize; 2]) -> Vec<u8> {
        let inside = |i: usize| (left..left + 8).contains(&(i % 32)) && (top..top + 8).contains(&(i / 32));
        (0..32 * 24).flat_map(|i| if inside(i) { [250, 240, 10] } else { [90; 3] }).collect()
    }

    /// Generates four rows of a dataset in `configs/datasets` with a camera of this field of view.
    pub(crate) fn dataset(name: &str, fov_deg: f64) -> TempDir {
        let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
        let table = |file: &str| -> toml::Table {
            std::fs::read_to_string(configs.join(file)).unwrap().parse().unwrap()
        };
        let mut config = table(&format!("datasets/{name}.toml"));
        for extended in ["world", "randomization"] {
            config.insert(extended.to_owned(), table(&format!("{extended}.toml")).into());
        }
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
        load_from(ImageSource::Cache, kind, &paths)
    }

    fn load_from(source: ImageSource, kind: Kind, paths: &[PathBuf]) -> Result<Examples> {
        Examples::load(&tiny(kind).task().unwrap(), source, paths, &|done, of| assert!(done <= of))
    }

    #[test]
    fn datasets_become_examples_in_their_order() {
        let [a, b] = [dataset("a", 60.0), dataset("b", 60.0)];
        let examples = load(Kind::Approach, &[&a, &b]).unwrap();
        assert_eq!((examples.len(), examples.ranges()), (8, vec![0..4, 4..8]));
        let reader = DatasetReader::open(b.path()).unwrap();
        let rows = reader.all::<ApproachRow>().unwrap().zip(reader.all::<ImagesRow>().unwrap());
        let Labels::PoseChanges(labels) = examples.labels() else { panic!("not pose changes") };
        for (i, (row, images)) in (4..).zip(rows) {
            let (row, images) = (row.unwrap(), images.unwrap().images);
            let label = LabelForm::Twist.label(&row.robot_from_current, &row.robot_from_goal);
            assert_eq!(labels[i].map(f64::to_bits), label.to_array().map(f64::to_bits));
            let decoded = [0, 1].map(|which| decode(&images[which], [32, 24]).unwrap()).concat();
            assert_eq!(examples.pixels(&[i]).unwrap(), [decoded]);
        }
    }

    #[test]
    fn streamed_images_are_the_cached_ones() {
        let [a, b] = [dataset("a", 60.0), dataset("b", 60.0)];
        let paths = [&a, &b].map(|dataset| dataset.path().to_owned());
        let streamed = load_from(ImageSource::Stream, Kind::Approach, &paths).unwrap();
        assert!(paths.iter().all(|path| !path.join("cache").exists()));
        assert_eq!(streamed.caches().count(), 0);
        let cached = load_from(ImageSource::Cache, Kind::Approach, &paths).unwrap();
        let indices = [6, 0, 3, 4, 6, 1];
        let pixels = cached.pixels(&indices).unwrap();
        assert_eq!(streamed.pixels(&indices).unwrap(), pixels);
        assert_eq!((pixels[0] == pixels[4], pixels[0] == pixels[1]), (true, false));
        destroy_images(&b);
        assert_eq!(cached.pixels(&indices).unwrap(), pixels);
        let error = streamed.pixels(&indices).unwrap_err().to_string();
        assert!(error.contains(b.path().to_str().unwrap()) && error.contains("row 2:"), "{error}");
        let error = load_from(ImageSource::Stream, Kind::Approach, &paths).unwrap_err().to_string();
        assert!(error.contains("row 0:"), "{error}");
    }

    #[test]
    fn maps_become_examples_of_their_task_only() {
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
    fn incompatible_datasets_are_named() {
        let [a, b] = [dataset("a", 60.0), dataset("b", 75.0)];
        let error = load(Kind::Approach, &[&a, &b]).unwrap_err().to_string();
        assert!(error.contains("horizontal_fov_deg: 60 and 75"), "{error}");
        assert!([&a, &b].iter().all(|dataset| error.contains(dataset.path().to_str().unwrap())), "{error}");
        let error = load(Kind::Approach, &[&a, &a]).unwrap_err().to_string();
        assert!(error.contains("each dataset once"), "{error}");
    }
}
