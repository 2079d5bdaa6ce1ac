//! Statistics of a dataset: counts, distributions of the labels, and sizes.

use super::data_file::damaged;
use super::running_stats::RunningStats;
pub use super::running_stats::{SummaryStats, percentile};
use crate::error::{Error, Result};
use parquet::file::metadata::{ParquetMetaDataReader, RowGroupMetaData};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Avoidance value from which a direction counts as blocked: an obstacle is within 60 degrees of it.
pub const BLOCKED: f64 = 0.5;

/// Statistics of a dataset, in meters and radians. Field names end in the unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DatasetStatistics {
    /// Motions, in the order of the configuration.
    pub motions: Vec<MotionCount>,
    /// Number of rows by shape of the target.
    pub target_shapes: BTreeMap<String, u64>,
    /// Number of rows by number of obstacles.
    pub obstacles: BTreeMap<u64, u64>,
    /// Hand poses: current and goal pose of an approach, or the single pose of an avoidance map.
    pub hands: Vec<HandStatistics>,
    /// Lower and upper limit of each joint of the arm \[rad\].
    pub joint_limits_rad: [[f64; 2]; 6],
    /// Labels.
    pub labels: LabelStatistics,
    /// Sizes of the Parquet files.
    pub bytes: ByteCounts,
}

/// Frequency of a motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MotionCount {
    /// Name of the motion.
    pub name: String,
    /// Configured share.
    pub share: f64,
    /// Number of rows with the motion.
    pub rows: u64,
}

/// Statistics of one hand pose.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HandStatistics {
    /// Name of the pose: `current` or `goal`, or `hand` if there is only one.
    pub name: String,
    /// Pose in the robot frame.
    pub pose: PoseStats,
    /// Joint angles of the arm \[rad\].
    pub joints_rad: [SummaryStats; 6],
}

/// Statistics of the six numbers of a pose, or of a change of pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PoseStats {
    /// Along x \[m\].
    pub x_m: SummaryStats,
    /// Along y \[m\].
    pub y_m: SummaryStats,
    /// Along z \[m\].
    pub z_m: SummaryStats,
    /// About x \[rad\].
    pub phi_rad: SummaryStats,
    /// About y \[rad\].
    pub theta_rad: SummaryStats,
    /// About z \[rad\].
    pub psi_rad: SummaryStats,
}

/// Statistics of the labels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LabelStatistics {
    /// Labels of approaches.
    Twist(TwistStatistics),
    /// Labels of avoidance maps.
    Values(MapStatistics),
}

/// Statistics of the twist from current to goal pose, in the current hand frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TwistStatistics {
    /// The six numbers.
    pub axes: PoseStats,
    /// Norm of the translation \[m\].
    pub translation_m: NormStatistics,
    /// Norm of the rotation, which is its angle \[rad\].
    pub rotation_rad: NormStatistics,
}

/// Statistics of a norm.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct NormStatistics {
    /// Minimum, mean, standard deviation and maximum.
    #[serde(flatten)]
    pub summary: SummaryStats,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub percentile_95: f64,
}

/// Statistics of all values of all avoidance maps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MapStatistics {
    /// Minimum, mean, standard deviation and maximum.
    #[serde(rename = "spread")]
    pub summary: SummaryStats,
    /// Fraction of zeros: no obstacle within 90 degrees of the direction.
    pub free: f64,
    /// Fraction of values of at least [`BLOCKED`].
    pub blocked: f64,
    /// Fraction of values in each tenth of 0 to 1.
    pub tenths: [f64; 10],
}

/// Sizes of the contents of the Parquet files, in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ByteCounts {
    /// Images: PNG files with about 5 bytes of overhead each.
    pub images: u64,
    /// All other columns, compressed.
    pub labels: u64,
    /// Indices and footers.
    pub metadata: u64,
    /// Total.
    pub total: u64,
}

impl PoseStats {
    pub(super) fn new(axes: &[RunningStats; 6]) -> Self {
        let [x_m, y_m, z_m, phi_rad, theta_rad, psi_rad] = axes.map(|axis| axis.summary());
        Self { x_m, y_m, z_m, phi_rad, theta_rad, psi_rad }
    }

    /// Returns the statistics in the order of the six numbers.
    pub fn to_array(&self) -> [SummaryStats; 6] {
        [self.x_m, self.y_m, self.z_m, self.phi_rad, self.theta_rad, self.psi_rad]
    }
}

impl HandStatistics {
    /// Returns the smallest distance of any joint from a limit \[rad\], and the number of that joint, counted from 0.
    pub fn joint_margin(&self, limits: &[[f64; 2]; 6]) -> (f64, usize) {
        let margins = self.joints_rad.iter().zip(limits).enumerate();
        margins
            .map(|(joint, (angle, [lower, upper]))| ((angle.min - lower).min(upper - angle.max), joint))
            .fold((f64::INFINITY, 0), |least, margin| if margin.0 < least.0 { margin } else { least })
    }
}

impl NormStatistics {
    pub(super) fn new(mut values: Vec<f64>) -> Self {
        let mut stats = RunningStats::EMPTY;
        for &value in &values {
            stats.add(value);
        }
        values.sort_by(f64::total_cmp);
        Self {
            summary: stats.summary(),
            median: percentile(&values, 50.0),
            percentile_95: percentile(&values, 95.0),
        }
    }
}

impl ByteCounts {
    /// Reads the footers of all files.
    pub(super) fn read(paths: impl Iterator<Item = PathBuf>, total: u64) -> Result<Self> {
        let mut bytes = Self { images: 0, labels: 0, metadata: 0, total };
        for path in paths {
            bytes.add_columns(&path)?;
        }
        bytes.metadata = total.saturating_sub(bytes.images + bytes.labels);
        Ok(bytes)
    }

    /// Adds the sizes of the columns, from the footer of a file.
    fn add_columns(&mut self, path: &Path) -> Result<()> {
        let file = File::open(path).map_err(Error::io(path))?;
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
    use crate::fixture::{config, make};
    use crate::read::DatasetReader;
    use crate::row::{ApproachRow, AvoidanceRow, ExampleGenerator, ImagesRow, Row, SceneRow};
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
        let statistics = DatasetStatistics::compute(&reader).unwrap();
        (dir, reader, statistics)
    }

    fn all<R: Row>(reader: &DatasetReader) -> Vec<R> {
        reader.all().unwrap().collect::<Result<_>>().unwrap()
    }

    /// Compares with a two-pass computation.
    fn assert_summary(found: &SummaryStats, numbers: &[f64]) {
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

    fn assert_axes(found: &PoseStats, numbers: &[[f64; 6]]) {
        for (axis, summary) in found.to_array().iter().enumerate() {
            assert_summary(summary, &numbers.iter().map(|row| row[axis]).collect::<Vec<_>>());
        }
    }

    fn six(pose: &HandPose) -> [f64; 6] {
        let (p, a) = (pose.position, pose.angles);
        [p.x, p.y, p.z, a.x, a.y, a.z]
    }

    #[test]
    fn statistics_of_approaches_follow_from_their_poses() {
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
            assert_summary(&found.summary, &numbers);
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
    fn statistics_of_maps_follow_from_their_values() {
        let (_dir, reader, statistics) = dataset("avoid");
        let values: Vec<f64> = all::<AvoidanceRow>(&reader)
            .iter()
            .flat_map(|row| row.values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>())
            .collect();
        let share = |holds: &dyn Fn(f64) -> bool| {
            values.iter().filter(|&&v| holds(v)).count() as f64 / values.len() as f64
        };
        let LabelStatistics::Values(found) = &statistics.labels else { panic!("{statistics:?}") };
        assert_summary(&found.summary, &values);
        assert_relative_eq!(found.free, share(&|v| v == 0.0));
        assert_relative_eq!(found.blocked, share(&|v| v >= 0.5));
        assert_relative_eq!(found.tenths[0], share(&|v| v < 0.1));
        assert_relative_eq!(found.tenths[9], share(&|v| v >= 0.9));
        assert!(found.free > 0.1 && found.blocked > 0.1, "{found:?}");
        assert_eq!(statistics.hands.len(), 1);
    }

    #[test]
    fn counts_agree_with_the_scenes() {
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
        let generator = ExampleGenerator::new(&config).unwrap();
        for index in 0..ROWS {
            motions[generator.example(index).unwrap().placement.motion] += 1;
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
    fn sizes_add_up() {
        for name in ["c", "avoid"] {
            let (_dir, reader, DatasetStatistics { bytes, .. }) = dataset(name);
            let images = all::<ImagesRow>(&reader).into_iter().flat_map(|row| row.images);
            let png = images.map(|png| png.len() as u64).sum::<u64>();
            // The difference is lengths of images and page headers, of which these tiny files have many.
            assert!((png..png + png / 20).contains(&bytes.images), "{} of {png}", bytes.images);
            assert!(bytes.labels > 1000 && bytes.metadata > 1000, "{bytes:?}");
            assert_eq!(bytes.images + bytes.labels + bytes.metadata, reader.info().bytes());
        }
    }
}
