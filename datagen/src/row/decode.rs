//! Rows as a reader gets them: each kind of row reads only the columns it names.

use crate::config::Kind;
use crate::error::{Error, Result};
use arrow_array::cast::AsArray as _;
use arrow_array::types::{Float32Type, Float64Type, Int64Type, UInt64Type};
use arrow_array::{
    Array, BinaryArray, FixedSizeListArray, Int64Array, RecordBatch, StringArray, UInt64Array,
};
use nalgebra::{Isometry3, Point2, Quaternion, Translation3, Unit, Vector3};
use std::path::Path;
use world::Scene;
use world::pose::HandPose;

/// A part of a dataset's rows.
pub trait Row: Clone + Send {
    /// Kind of the datasets that have it; `None` where both have.
    const KIND: Option<Kind>;
    /// The columns it is made of.
    const COLUMNS: &'static [&'static str];
    /// The rows of a batch that has these columns.
    fn decode(batch: &Batch<'_>) -> Result<Vec<Self>>;
}

/// What the camera saw.
#[derive(Debug, Clone, PartialEq)]
pub struct ImagesRow {
    /// Row of the dataset.
    pub index: u64,
    /// PNG at each pose of the hand: current and goal of an approach, the only one of an avoidance map.
    pub images: Vec<Vec<u8>>,
}

/// The motion that `CNN_approach` learns.
#[derive(Debug, Clone, PartialEq)]
pub struct ApproachRow {
    /// Row of the dataset.
    pub index: u64,
    /// Current pose of the hand.
    pub robot_from_current: Isometry3<f64>,
    /// Goal pose of the hand.
    pub robot_from_goal: Isometry3<f64>,
}

/// The map that `CNN_avoid` learns.
#[derive(Debug, Clone, PartialEq)]
pub struct AvoidanceRow {
    /// Row of the dataset.
    pub index: u64,
    /// Pose of the hand.
    pub robot_from_hand: Isometry3<f64>,
    /// Avoidance map, Eq. (1): a value in `[0, 1]` a measuring point.
    pub values: Vec<f32>,
}

/// What stood on the table.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneRow {
    /// Row of the dataset.
    pub index: u64,
    /// The scene, exactly as it was rendered.
    pub scene: Scene,
}

/// Which motion it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MotionRow {
    /// Row of the dataset.
    pub index: u64,
    /// Index into the configuration's motions.
    pub motion: usize,
}

/// The camera that saw it.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraRow {
    /// Row of the dataset.
    pub index: u64,
    /// Focal length, the same along both axes \[pixels\].
    pub focal: f64,
    /// Principal point \[pixels\].
    pub center: Point2<f64>,
    /// Mount.
    pub hand_from_camera: Isometry3<f64>,
}

impl Row for ImagesRow {
    const KIND: Option<Kind> = None;
    /// A dataset has the first, or the other two.
    const COLUMNS: &'static [&'static str] =
        &["index", "image.bytes", "image_current.bytes", "image_goal.bytes"];

    fn decode(batch: &Batch<'_>) -> Result<Vec<Self>> {
        let index = batch.counts("index")?;
        let names: &[_] = match batch.columns.column_by_name("image") {
            Some(_) => &["image"],
            None => &["image_current", "image_goal"],
        };
        let columns = names.iter().map(|name| batch.images(name)).collect::<Result<Vec<_>>>()?;
        let row = |i: usize| Self {
            index: index.value(i),
            images: columns.iter().map(|column| column.value(i).to_vec()).collect(),
        };
        Ok((0..batch.rows()).map(row).collect())
    }
}

impl Row for ApproachRow {
    const KIND: Option<Kind> = Some(Kind::Approach);
    const COLUMNS: &'static [&'static str] = &["index", "pose_current", "pose_goal"];

    fn decode(batch: &Batch<'_>) -> Result<Vec<Self>> {
        let index = batch.counts("index")?;
        let [pose_current, pose_goal] = [batch.poses("pose_current")?, batch.poses("pose_goal")?];
        let row = |i: usize| Self {
            index: index.value(i),
            robot_from_current: pose_current[i].robot_from_hand(),
            robot_from_goal: pose_goal[i].robot_from_hand(),
        };
        Ok((0..batch.rows()).map(row).collect())
    }
}

impl Row for AvoidanceRow {
    const KIND: Option<Kind> = Some(Kind::Avoidance);
    const COLUMNS: &'static [&'static str] = &["index", "pose", "values"];

    fn decode(batch: &Batch<'_>) -> Result<Vec<Self>> {
        let index = batch.counts("index")?;
        let pose = batch.poses("pose")?;
        let values = batch.maps("values")?;
        let row = |i: usize| Self {
            index: index.value(i),
            robot_from_hand: pose[i].robot_from_hand(),
            values: values[i].to_vec(),
        };
        Ok((0..batch.rows()).map(row).collect())
    }
}

impl Row for SceneRow {
    const KIND: Option<Kind> = None;
    const COLUMNS: &'static [&'static str] = &["index", "scene"];

    fn decode(batch: &Batch<'_>) -> Result<Vec<Self>> {
        let index = batch.counts("index")?;
        let texts = batch.texts("scene")?;
        let row = |i: usize| {
            let scene = serde_json::from_str(texts.value(i)).map_err(|_| batch.wrong("scene"))?;
            Ok(Self { index: index.value(i), scene })
        };
        (0..batch.rows()).map(row).collect()
    }
}

impl Row for MotionRow {
    const KIND: Option<Kind> = None;
    const COLUMNS: &'static [&'static str] = &["index", "motion"];

    fn decode(batch: &Batch<'_>) -> Result<Vec<Self>> {
        let (index, motions) = (batch.counts("index")?, batch.classes("motion")?);
        let row = |i: usize| {
            let motion = usize::try_from(motions.value(i)).map_err(|_| batch.wrong("motion"))?;
            Ok(Self { index: index.value(i), motion })
        };
        (0..batch.rows()).map(row).collect()
    }
}

impl Row for CameraRow {
    const KIND: Option<Kind> = None;
    const COLUMNS: &'static [&'static str] = &["index", "camera", "hand_from_camera"];

    fn decode(batch: &Batch<'_>) -> Result<Vec<Self>> {
        let index = batch.counts("index")?;
        let (cameras, mounts) = (batch.doubles("camera")?, batch.doubles("hand_from_camera")?);
        let row = |(i, ([focal, _, u, v], [x, y, z, qx, qy, qz, qw])): (usize, ([f64; 4], [f64; 7]))| Self {
            index: index.value(i),
            focal,
            center: Point2::new(u, v),
            hand_from_camera: Isometry3::from_parts(
                Translation3::new(x, y, z),
                Unit::new_unchecked(Quaternion::new(qw, qx, qy, qz)),
            ),
        };
        Ok(cameras.into_iter().zip(mounts).enumerate().map(row).collect())
    }
}

/// Some rows of a file, and which file.
pub struct Batch<'a> {
    pub(crate) path: &'a Path,
    pub(crate) columns: &'a RecordBatch,
}

impl Batch<'_> {
    pub(crate) fn rows(&self) -> usize {
        self.columns.num_rows()
    }

    pub(crate) fn counts(&self, name: &str) -> Result<&UInt64Array> {
        self.column(name)?.as_primitive_opt::<UInt64Type>().ok_or_else(|| self.wrong(name))
    }

    pub(crate) fn texts(&self, name: &str) -> Result<&StringArray> {
        self.column(name)?.as_string_opt::<i32>().ok_or_else(|| self.wrong(name))
    }

    fn lists(&self, name: &str) -> Result<&FixedSizeListArray> {
        self.column(name)?.as_fixed_size_list_opt().ok_or_else(|| self.wrong(name))
    }

    fn images(&self, name: &str) -> Result<&BinaryArray> {
        let bytes = self.column(name)?.as_struct_opt().and_then(|image| image.column_by_name("bytes"));
        bytes.and_then(|bytes| bytes.as_binary_opt::<i32>()).ok_or_else(|| self.wrong(name))
    }

    fn poses(&self, name: &str) -> Result<Vec<HandPose>> {
        let pose = |v: [f64; 6]| HandPose {
            position: Vector3::new(v[0], v[1], v[2]),
            angles: Vector3::new(v[3], v[4], v[5]),
        };
        Ok(self.doubles(name)?.into_iter().map(pose).collect())
    }

    /// Rows of N exact numbers.
    pub(crate) fn doubles<const N: usize>(&self, name: &str) -> Result<Vec<[f64; N]>> {
        let numbers = self.lists(name)?.values().as_primitive_opt::<Float64Type>();
        let (rows, rest) = numbers.ok_or_else(|| self.wrong(name))?.values().as_chunks();
        let fits = rest.is_empty() && rows.len() == self.rows();
        if fits { Ok(rows.to_vec()) } else { Err(self.wrong(name)) }
    }

    /// Rows of as many numbers as networks take.
    pub(crate) fn maps(&self, name: &str) -> Result<Vec<&[f32]>> {
        let lists = self.lists(name)?;
        let numbers = lists.values().as_primitive_opt::<Float32Type>().ok_or_else(|| self.wrong(name))?;
        Ok(numbers.values().chunks_exact(lists.value_length().max(1) as usize).collect())
    }

    /// Indices into names.
    pub(crate) fn classes(&self, name: &str) -> Result<&Int64Array> {
        self.column(name)?.as_primitive_opt::<Int64Type>().ok_or_else(|| self.wrong(name))
    }

    fn column(&self, name: &str) -> Result<&dyn Array> {
        let column = self.columns.column_by_name(name).filter(|column| column.null_count() == 0);
        column.map(AsRef::as_ref).ok_or_else(|| self.wrong(name))
    }

    /// The error for a column that flowservo would not have written so.
    pub(crate) fn wrong(&self, name: &str) -> Error {
        let found = match self.columns.column_by_name(name) {
            Some(column) => {
                format!("values of type {} with {} nulls", column.data_type(), column.null_count())
            }
            None => "no such column".to_owned(),
        };
        Error::Damaged {
            path: self.path.to_owned(),
            expected: format!("column {name} as flowservo writes it"),
            found,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reader::DatasetReader;
    use crate::tiny::{config, make};
    use world::Camera;
    use world::units::{to_deg, to_mm};

    /// Height of the reference point \[mm\], and half-widths \[mm, degrees\], as printed in Section 6.2 of the paper.
    type Range = (f64, [f64; 6]);
    const RANGE_1: Range = (150.0, [100.0, 100.0, 100.0, 5.0, 5.0, 30.0]);
    const RANGE_2A: Range = (80.0, [50.0, 50.0, 30.0, 5.0, 5.0, 10.0]);
    const RANGE_2B: Range = (80.0, [10.0, 10.0, 10.0, 5.0, 5.0, 5.0]);
    const RANGE_B: Range = (80.0, [30.0, 30.0, 20.0, 5.0, 5.0, 10.0]);

    fn is_within((reference, half): Range, robot_from_hand: &Isometry3<f64>, scene: &Scene) -> bool {
        let HandPose { position, angles } = HandPose::from_transform(robot_from_hand);
        let offset = (position - scene.target_center().coords).map(to_mm) - Vector3::z() * reference;
        let offsets = offset.iter().copied().chain(angles.iter().copied().map(to_deg));
        offsets.zip(half).all(|(offset, half)| offset.abs() <= half + 1e-9)
    }

    fn rows<R: Row>(name: &str) -> Vec<R> {
        let dir = tempfile::tempdir().unwrap();
        make(&config(name, 30), dir.path()).unwrap();
        DatasetReader::open(dir.path()).unwrap().all().unwrap().collect::<Result<_>>().unwrap()
    }

    #[test]
    fn approaches_lie_in_the_ranges_of_the_paper() {
        for (name, coarse, fine) in [
            ("a", [RANGE_1, RANGE_1], [RANGE_2A, RANGE_2B]),
            ("b", [RANGE_B, RANGE_B], [RANGE_2B, RANGE_2B]),
            ("c", [RANGE_B, RANGE_B], [RANGE_2B, RANGE_2B]),
        ] {
            let mut fine_rows = 0;
            for (row, SceneRow { scene, .. }) in rows::<ApproachRow>(name).iter().zip(rows::<SceneRow>(name))
            {
                let within = |[current, goal]: [Range; 2]| {
                    is_within(current, &row.robot_from_current, &scene)
                        && is_within(goal, &row.robot_from_goal, &scene)
                };
                assert!(within(coarse) || within(fine), "{name}, row {}", row.index);
                fine_rows += usize::from(within(fine));
            }
            assert!((5..=25).contains(&fine_rows), "{name}: {fine_rows} of 30");
        }
    }

    #[test]
    fn a_camera_is_read_as_it_was_configured() {
        let expected = Camera::new(&config("a", 1).world.camera);
        for row in rows::<CameraRow>("a") {
            assert_eq!((row.focal, row.center), (expected.focal, expected.center));
            assert_eq!(row.hand_from_camera, expected.hand_from_camera);
        }
    }

    #[test]
    fn hands_of_avoidance_maps_lie_in_the_ranges_of_the_paper() {
        for (row, SceneRow { scene, .. }) in
            rows::<AvoidanceRow>("avoid").iter().zip(rows::<SceneRow>("avoid"))
        {
            let within = |range| is_within(range, &row.robot_from_hand, &scene);
            assert!(within(RANGE_1) || within(RANGE_2A), "row {}", row.index);
            assert_eq!(row.values.len(), 180);
            assert_eq!(scene.obstacles.is_empty(), row.values.iter().all(|&value| value == 0.0));
        }
    }
}
