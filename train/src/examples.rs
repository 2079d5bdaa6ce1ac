//! What a network learns from: the images of datasets at the size of its input, and their labels. Labels are in memory; images
//! come from a cache or are decoded when a batch needs them.

use std::borrow::Cow;
use std::ops::Range;
use std::path::{Path, PathBuf};

use datagen::{ApproachRow, AvoidanceRow, DatasetReader};
use serde::{Deserialize, Serialize};
use world::config::CameraConfig;

use crate::cache::ImageCache;
use crate::camera;
use crate::config::{ImageSource, Task};
use crate::error::{Error, Result};
use crate::net::DIRECTIONS;
use crate::stream::ImageStream;

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
#[derive(Debug)]
pub struct Examples {
    input: [usize; 2],
    camera: CameraConfig,
    /// Those of each dataset.
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
    /// The pixels of examples, those of all images of an example one after the other.
    fn pixels(&self, examples: &[u64]) -> Result<Vec<Cow<'_, [u8]>>> {
        Ok(match self {
            Self::Cached(cache) => examples.iter().map(|&i| cache.pixels(i).into()).collect(),
            Self::Streamed(stream) => stream.pixels(examples)?.into_iter().map(Cow::from).collect(),
        })
    }
}

/// One label an example.
#[derive(Debug)]
pub(crate) enum Labels {
    /// Metres and radians.
    PoseChanges(Vec<[f64; 6]>),
    /// Avoidance maps, one after the other.
    AvoidanceMaps(Vec<f32>),
}

impl Examples {
    /// Reads the labels of datasets and opens their images. Those that are to be cached and have not been decoded yet are
    /// now, in parallel, and `progress` hears how many examples of how many are there.
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
                ImageSource::Cache => DatasetImages::Cached(ImageCache::of(&stream, &decoded)?),
                ImageSource::Stream => {
                    // Images that do not fit are found before training.
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

    /// No examples yet.
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
                        let problem = format!("its map has {} directions, not {DIRECTIONS}", values.len());
                        return Err(Error::Row {
                            path: reader.dir().to_owned(),
                            row: index as usize,
                            problem,
                        });
                    }
                    maps.extend(values);
                }
            }
            _ => panic!("labels of the other task"),
        }
        Ok(())
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

    /// The file with the decoded images of each dataset: in its folder, or in a folder of the user's below the system's
    /// temporary one where nothing can be written there. None where images are streamed.
    pub fn caches(&self) -> impl Iterator<Item = &Path> {
        self.images.iter().filter_map(|images| match images {
            DatasetImages::Cached(cache) => Some(cache.path()),
            DatasetImages::Streamed(_) => None,
        })
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

    /// The pixels of some examples, in the order asked for; those of all images of an example one after the other.
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

#[cfg(test)]
pub(crate) mod tests {
    use std::array::from_fn;
    use std::sync::atomic::AtomicBool;

    use datagen::{DatasetConfig, ImagesRow, Kind, Options, generate};
    use tempfile::TempDir;
    use world::LabelForm;

    use super::*;
    use crate::cache::tests::{destroy_images, in_memory};
    use crate::config::tests::tiny;
    use crate::input::decode;

    /// Examples whose images show a bright square on gray; the label is where it is, or where it went.
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

    /// Examples of [`squares`] as if they were of two datasets.
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
        /// The same, with a label that is no number.
        pub(crate) fn with_a_label_missing(mut self) -> Self {
            let Labels::PoseChanges(labels) = &mut self.labels else { panic!("not pose changes") };
            labels[0][0] = f64::NAN;
            self
        }

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
