//! Decodes rows from Arrow columns. Each row type reads only its own columns.

use super::batch::Batch;
use crate::config::Kind;
use crate::error::Result;
use nalgebra::{Isometry3, Point2, Quaternion, Translation3, Unit};
use world::Scene;

/// A row type: a selection of the columns of a dataset.
pub trait Row: Clone + Send {
    /// Kind of the datasets with these columns; `None` if both kinds have them.
    const KIND: Option<Kind>;
    /// Columns of the row type.
    const COLUMNS: &'static [&'static str];
    /// Decodes all rows of a batch with these columns.
    fn decode(batch: &Batch<'_>) -> Result<Vec<Self>>;
}

/// The wrist images.
#[derive(Debug, Clone, PartialEq)]
pub struct ImagesRow {
    /// Row number in the dataset.
    pub index: u64,
    /// PNG image at each hand pose: current and goal pose of an approach, or the single pose of an avoidance map.
    pub images: Vec<Vec<u8>>,
}

/// The hand poses of an approach, which determine the label of `CNN_approach`.
#[derive(Debug, Clone, PartialEq)]
pub struct ApproachRow {
    /// Row number in the dataset.
    pub index: u64,
    /// Current pose of the hand.
    pub robot_from_current: Isometry3<f64>,
    /// Goal pose of the hand.
    pub robot_from_goal: Isometry3<f64>,
}

/// The avoidance map, the label of `CNN_avoid`.
#[derive(Debug, Clone, PartialEq)]
pub struct AvoidanceRow {
    /// Row number in the dataset.
    pub index: u64,
    /// Pose of the hand.
    pub robot_from_hand: Isometry3<f64>,
    /// Avoidance map, Eq. (1): a value in `[0, 1]` for each measuring point.
    pub values: Vec<f32>,
}

/// The scene.
#[derive(Debug, Clone, PartialEq)]
pub struct SceneRow {
    /// Row number in the dataset.
    pub index: u64,
    /// Scene exactly as rendered.
    pub scene: Scene,
}

/// The motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MotionRow {
    /// Row number in the dataset.
    pub index: u64,
    /// Index of the motion in the configuration.
    pub motion: usize,
}

/// The camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraRow {
    /// Row number in the dataset.
    pub index: u64,
    /// Focal length, the same along both axes \[pixels\].
    pub focal: f64,
    /// Principal point \[pixels\].
    pub center: Point2<f64>,
    /// Mount of the camera on the hand.
    pub hand_from_camera: Isometry3<f64>,
}

impl Row for ImagesRow {
    const KIND: Option<Kind> = None;
    /// Columns of both kinds of dataset; each dataset has one or two of the images.
    const COLUMNS: &'static [&'static str] =
        &["index", "image.bytes", "image_current.bytes", "image_goal.bytes"];

    fn decode(batch: &Batch<'_>) -> Result<Vec<Self>> {
        let index = batch.counts("index")?;
        let names: &[_] = if batch.has("image") { &["image"] } else { &["image_current", "image_goal"] };
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{config, make};
    use crate::read::DatasetReader;
    use nalgebra::Vector3;
    use world::Camera;
    use world::pose::HandPose;
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
