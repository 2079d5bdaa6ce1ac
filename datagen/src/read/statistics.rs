//! What the rows of a dataset are like: counts, ranges and spreads of the labels, and where the bytes are. No image is read.

use crate::counts::Counts;
use crate::error::Result;
use crate::publish::io;
use crate::reader::{DatasetReader, damaged};
use crate::spread::{Spread, Tally, percentile};
use parquet::file::metadata::{ParquetMetaDataReader, RowGroupMetaData};
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

/// An avoidance value from here on means that the direction is blocked: an obstacle is within 60 degrees of it.
pub const BLOCKED: f64 = 0.5;

/// What the rows of a dataset are like. Metres and radians; keys end in the unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DatasetStatistics {
    /// The motions, in the configuration's order.
    pub motions: Vec<MotionCount>,
    /// Rows by the target's shape.
    pub target_shapes: BTreeMap<String, u64>,
    /// Rows by the number of obstacles.
    pub obstacles: BTreeMap<u64, u64>,
    /// The hand at each of its poses: current and goal of an approach, the only one of an avoidance map.
    pub hands: Vec<HandStatistics>,
    /// Smallest and largest angle of each joint of the arm \[rad\].
    pub joint_limits_rad: [[f64; 2]; 6],
    /// What is learned.
    pub labels: LabelStatistics,
    /// Where the bytes are.
    pub bytes: ByteCounts,
}

/// How often a motion was drawn.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MotionCount {
    /// Its name.
    pub name: String,
    /// The share that was asked for.
    pub share: f64,
    /// The rows that have it.
    pub rows: u64,
}

/// Where the hand is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HandStatistics {
    /// Which of its poses: `current`, `goal`, or `hand` where there is one.
    pub name: String,
    /// Its pose in the robot frame.
    pub pose: PoseSpreads,
    /// The arm's joint angles \[rad\].
    pub joints_rad: [Spread; 6],
}

/// The six numbers of a pose, or of a change of pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseSpreads {
    /// Along x \[m\].
    pub x_m: Spread,
    /// Along y \[m\].
    pub y_m: Spread,
    /// Along z \[m\].
    pub z_m: Spread,
    /// About x \[rad\].
    pub phi_rad: Spread,
    /// About y \[rad\].
    pub theta_rad: Spread,
    /// About z \[rad\].
    pub psi_rad: Spread,
}

/// What is learned.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LabelStatistics {
    /// Of a dataset of approaches.
    Twist(TwistStatistics),
    /// Of a dataset of avoidance maps.
    Values(MapStatistics),
}

/// The twist from current to goal, in the current hand frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TwistStatistics {
    /// Its six numbers.
    pub axes: PoseSpreads,
    /// Norm of its translation \[m\].
    pub translation_m: NormStatistics,
    /// Norm of its rotation, the angle \[rad\].
    pub rotation_rad: NormStatistics,
}

/// A norm over all rows.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct NormStatistics {
    /// Extremes, mean and standard deviation.
    #[serde(flatten)]
    pub spread: Spread,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub percentile_95: f64,
}

/// All values of all avoidance maps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MapStatistics {
    /// Extremes, mean and standard deviation.
    pub spread: Spread,
    /// Share of the values that are 0: no obstacle within 90 degrees.
    pub free: f64,
    /// Share of the values from [`BLOCKED`] on.
    pub blocked: f64,
    /// Share of the values in each tenth of 0 to 1.
    pub tenths: [f64; 10],
}

/// Where the bytes of the files with rows are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ByteCounts {
    /// In images: PNG, and some 5 bytes each.
    pub images: u64,
    /// In all other columns, compressed.
    pub labels: u64,
    /// In indices and footers.
    pub metadata: u64,
    /// All of them.
    pub total: u64,
}

impl DatasetStatistics {
    /// Of a complete dataset: reads all columns but images and scenes, with the threads of the current rayon pool. Does not
    /// depend on their number. Holds two numbers a row in memory, for the percentiles.
    pub fn of(reader: &DatasetReader) -> Result<Self> {
        let config = &reader.info().config;
        let parts: Vec<Result<Counts>> =
            reader.shards().into_par_iter().map(|rows| Counts::of(reader, rows)).collect();
        let mut whole = Counts::new(config);
        for part in parts {
            whole.join(part?);
        }
        let mut bytes = ByteCounts { images: 0, labels: 0, metadata: 0, total: reader.info().bytes() };
        for file in &reader.info().files {
            bytes.add_columns(&reader.dir().join(&file.path))?;
        }
        bytes.metadata = bytes.total.saturating_sub(bytes.images + bytes.labels);
        Ok(whole.finish(config, bytes))
    }
}

impl PoseSpreads {
    pub(crate) fn of(tallies: &[Tally; 6]) -> Self {
        let [x_m, y_m, z_m, phi_rad, theta_rad, psi_rad] = tallies.map(|tally| tally.spread());
        Self { x_m, y_m, z_m, phi_rad, theta_rad, psi_rad }
    }

    /// In the order of the six numbers.
    pub fn to_array(&self) -> [Spread; 6] {
        [self.x_m, self.y_m, self.z_m, self.phi_rad, self.theta_rad, self.psi_rad]
    }
}

impl HandStatistics {
    /// Least distance of any joint from a limit \[rad\], and which joint it is, counted from 0.
    pub fn joint_margin(&self, limits: &[[f64; 2]; 6]) -> (f64, usize) {
        let margins = self.joints_rad.iter().zip(limits).enumerate();
        margins
            .map(|(joint, (angle, [lower, upper]))| ((angle.min - lower).min(upper - angle.max), joint))
            .fold((f64::INFINITY, 0), |least, margin| if margin.0 < least.0 { margin } else { least })
    }
}

impl NormStatistics {
    pub(crate) fn of(mut values: Vec<f64>) -> Self {
        let mut tally = Tally::EMPTY;
        for &value in &values {
            tally.add(value);
        }
        values.sort_by(f64::total_cmp);
        Self {
            spread: tally.spread(),
            median: percentile(&values, 50.0),
            percentile_95: percentile(&values, 95.0),
        }
    }
}

impl ByteCounts {
    /// What the footer of a file says of its columns.
    fn add_columns(&mut self, path: &Path) -> Result<()> {
        let file = File::open(path).map_err(|source| io(path, source))?;
        let metadata =
            ParquetMetaDataReader::new().parse_and_finish(&file).map_err(|error| damaged(path, &error))?;
        for column in metadata.row_groups().iter().flat_map(RowGroupMetaData::columns) {
            let is_image = column.column_path().parts().last().is_some_and(|part| part == "bytes");
            let counter = if is_image { &mut self.images } else { &mut self.labels };
            *counter += u64::try_from(column.compressed_size()).unwrap_or(0);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::row::{ApproachRow, AvoidanceRow, ImagesRow, Row, SceneRow};
    use crate::tiny::{config, make};
    use approx::assert_relative_eq;
    use tempfile::TempDir;
    use world::LabelForm;
    use world::arm::JointVector;
    use world::environment::Environment;
    use world::pose::HandPose;

    const ROWS: u64 = 10;

    fn dataset(name: &str) -> (TempDir, DatasetReader, DatasetStatistics) {
        let dir = tempfile::tempdir().unwrap();
        make(&config(name, ROWS), dir.path()).unwrap();
        let reader = DatasetReader::open(dir.path()).unwrap();
        let statistics = DatasetStatistics::of(&reader).unwrap();
        (dir, reader, statistics)
    }

    fn all<R: Row>(reader: &DatasetReader) -> Vec<R> {
        reader.all().unwrap().collect::<Result<_>>().unwrap()
    }

    /// Two passes over the numbers themselves.
    fn assert_spread(found: &Spread, numbers: &[f64]) {
        let count = numbers.len() as f64;
        let mean = numbers.iter().sum::<f64>() / count;
        let variance = numbers.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / count;
        let mut sorted = numbers.to_vec();
        sorted.sort_by(f64::total_cmp);
        assert_relative_eq!(found.min, sorted[0], epsilon = 1e-9);
        assert_relative_eq!(found.max, sorted[sorted.len() - 1], epsilon = 1e-9);
        assert_relative_eq!(found.mean, mean, epsilon = 1e-9);
        assert_relative_eq!(found.std, variance.sqrt(), epsilon = 1e-9);
    }

    fn assert_axes(found: &PoseSpreads, numbers: &[[f64; 6]]) {
        for (axis, spread) in found.to_array().iter().enumerate() {
            assert_spread(spread, &numbers.iter().map(|row| row[axis]).collect::<Vec<_>>());
        }
    }

    fn six(pose: &HandPose) -> [f64; 6] {
        let (p, a) = (pose.position, pose.angles);
        [p.x, p.y, p.z, a.x, a.y, a.z]
    }

    #[test]
    fn approaches_are_what_their_poses_say() {
        let (_dir, reader, statistics) = dataset("c");
        let rows: Vec<ApproachRow> = all(&reader);
        let twists: Vec<_> = rows
            .iter()
            .map(|row| LabelForm::Twist.label(&row.robot_from_current, &row.robot_from_goal))
            .collect();
        let LabelStatistics::Twist(found) = &statistics.labels else { panic!("{statistics:?}") };
        assert_axes(&found.axes, &twists.iter().map(world::PoseChange::to_array).collect::<Vec<_>>());
        let distances: Vec<f64> = twists.iter().map(|twist| twist.translation.norm()).collect();
        let angles: Vec<f64> = twists.iter().map(|twist| twist.rotation.norm()).collect();
        for (found, mut numbers) in [(&found.translation_m, distances), (&found.rotation_rad, angles)] {
            assert_spread(&found.spread, &numbers);
            numbers.sort_by(f64::total_cmp);
            // Ten numbers: the median is between the fifth and the sixth, the 95th percentile at rank 8.55.
            assert_relative_eq!(found.median, numbers[4].midpoint(numbers[5]), epsilon = 1e-12);
            let p95 = numbers[8] + 0.55 * (numbers[9] - numbers[8]);
            assert_relative_eq!(found.percentile_95, p95, epsilon = 1e-12);
        }
        let poses = |of: fn(&ApproachRow) -> &nalgebra::Isometry3<f64>| -> Vec<[f64; 6]> {
            rows.iter().map(|row| six(&HandPose::from_transform(of(row)))).collect()
        };
        assert_axes(&statistics.hands[0].pose, &poses(|row| &row.robot_from_current));
        assert_axes(&statistics.hands[1].pose, &poses(|row| &row.robot_from_goal));
    }

    #[test]
    fn maps_are_what_their_values_say() {
        let (_dir, reader, statistics) = dataset("avoid");
        let values: Vec<f64> = all::<AvoidanceRow>(&reader)
            .iter()
            .flat_map(|row| row.values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>())
            .collect();
        let share = |holds: &dyn Fn(f64) -> bool| {
            values.iter().filter(|&&v| holds(v)).count() as f64 / values.len() as f64
        };
        let LabelStatistics::Values(found) = &statistics.labels else { panic!("{statistics:?}") };
        assert_spread(&found.spread, &values);
        assert_relative_eq!(found.free, share(&|v| v == 0.0));
        assert_relative_eq!(found.blocked, share(&|v| v >= 0.5));
        assert_relative_eq!(found.tenths[0], share(&|v| v < 0.1));
        assert_relative_eq!(found.tenths[9], share(&|v| v >= 0.9));
        assert!(found.free > 0.1 && found.blocked > 0.1, "{found:?}");
        assert_eq!(statistics.hands.len(), 1);
    }

    #[test]
    fn what_is_counted_is_in_the_scenes() {
        let (_dir, reader, statistics) = dataset("c");
        let mut shapes = BTreeMap::new();
        let mut obstacles = BTreeMap::new();
        for SceneRow { scene, .. } in all(&reader) {
            *shapes.entry(scene.target.shape.name().to_owned()).or_insert(0) += 1;
            *obstacles.entry(scene.obstacles.len() as u64).or_insert(0) += 1;
        }
        assert_eq!((&statistics.target_shapes, &statistics.obstacles), (&shapes, &obstacles));
        assert!(shapes.len() == 2 && obstacles.len() > 2);
        let mut motions = vec![0; 2];
        let config = config("c", ROWS);
        let collector = crate::example::Collector::new(&config).unwrap();
        for index in 0..ROWS {
            motions[collector.example(index).unwrap().placement.motion] += 1;
        }
        assert_eq!(statistics.motions.iter().map(|motion| motion.rows).collect::<Vec<_>>(), motions);
    }

    #[test]
    fn the_arm_reaches_the_hands_within_its_limits() {
        let (_dir, reader, statistics) = dataset("avoid");
        let environment = Environment::new(&reader.info().config.world).unwrap();
        let mut least = f64::INFINITY;
        for row in all::<AvoidanceRow>(&reader) {
            let joints: JointVector = environment.arm.joints_for(&row.robot_from_hand).unwrap();
            for (i, [lower, upper]) in statistics.joint_limits_rad.iter().enumerate() {
                least = least.min(joints[i] - lower).min(upper - joints[i]);
                assert!(statistics.hands[0].joints_rad[i].min <= joints[i] + 1e-6);
                assert!(statistics.hands[0].joints_rad[i].max >= joints[i] - 1e-6);
            }
        }
        let (margin, joint) = statistics.hands[0].joint_margin(&statistics.joint_limits_rad);
        assert_relative_eq!(margin, least, epsilon = 1e-6);
        let (angles, [lower, upper]) =
            (statistics.hands[0].joints_rad[joint], statistics.joint_limits_rad[joint]);
        assert_relative_eq!(margin, (angles.min - lower).min(upper - angles.max));
    }

    #[test]
    fn every_byte_is_somewhere() {
        for name in ["c", "avoid"] {
            let (_dir, reader, DatasetStatistics { bytes, .. }) = dataset(name);
            let images = all::<ImagesRow>(&reader).into_iter().flat_map(|row| row.images);
            let png = images.map(|png| png.len() as u64).sum::<u64>();
            // Lengths of images and headers of pages, of which these tiny files have many.
            assert!((png..png + png / 20).contains(&bytes.images), "{} of {png}", bytes.images);
            assert!(bytes.labels > 1000 && bytes.metadata > 1000, "{bytes:?}");
            assert_eq!(bytes.images + bytes.labels + bytes.metadata, reader.info().bytes());
        }
    }
}
