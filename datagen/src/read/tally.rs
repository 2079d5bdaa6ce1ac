//! Computes statistics: files are read in parallel, and their tallies are merged in order.

use super::label_row::LabelRow;
use super::reader::DatasetReader;
use super::running_stats::RunningStats;
use super::statistics::{
    BLOCKED, ByteCounts, DatasetStatistics, HandStatistics, LabelStatistics, MapStatistics, MotionCount,
    NormStatistics, PoseStats, TwistStatistics,
};
use crate::config::{DatasetConfig, Kind};
use crate::error::{Error, Result};
use rayon::iter::{IntoParallelIterator, ParallelIterator};
use std::collections::BTreeMap;
use std::ops::Range;
use world::hiro::left_arm;

impl DatasetStatistics {
    /// Computes the statistics of a complete dataset, with the threads of the current rayon pool.
    ///
    /// Reads all columns except images and scenes. The result does not depend on the number of threads. Keeps two numbers per
    /// row in memory, for the percentiles.
    pub fn compute(reader: &DatasetReader) -> Result<Self> {
        let config = &reader.info().config;
        let parts: Vec<Result<Tally>> =
            reader.shards().into_par_iter().map(|rows| Tally::read(reader, rows)).collect();
        let mut whole = Tally::new(config);
        for part in parts {
            whole.merge(part?);
        }
        let paths = reader.info().files.iter().map(|file| reader.dir().join(&file.path));
        Ok(whole.finish(config, ByteCounts::read(paths, reader.info().bytes())?))
    }
}

/// Accumulated statistics of some rows.
struct Tally {
    motions: Vec<u64>,
    target_shapes: BTreeMap<String, u64>,
    obstacles: BTreeMap<u64, u64>,
    hands: Vec<[[RunningStats; 6]; 2]>,
    twists: TwistTally,
    maps: MapTally,
}

/// Accumulated statistics of twists.
struct TwistTally {
    axes: [RunningStats; 6],
    /// Norms of the translations and of the rotations.
    norms: [Vec<f64>; 2],
}

/// Accumulated statistics of the values of avoidance maps.
struct MapTally {
    values: RunningStats,
    /// Number of values in each tenth of 0 to 1.
    tenths: [u64; 10],
    free: u64,
    blocked: u64,
}

impl Tally {
    /// Creates an empty tally.
    fn new(config: &DatasetConfig) -> Self {
        let hands = match config.kind {
            Kind::Approach => 2,
            Kind::Avoidance => 1,
        };
        Self {
            motions: vec![0; config.motions.len()],
            target_shapes: BTreeMap::new(),
            obstacles: BTreeMap::new(),
            hands: vec![[[RunningStats::EMPTY; 6]; 2]; hands],
            twists: TwistTally { axes: [RunningStats::EMPTY; 6], norms: [Vec::new(), Vec::new()] },
            maps: MapTally { values: RunningStats::EMPTY, tenths: [0; 10], free: 0, blocked: 0 },
        }
    }

    /// Reads and accumulates a range of rows.
    fn read(reader: &DatasetReader, rows: Range<u64>) -> Result<Self> {
        let mut tally = Self::new(&reader.info().config);
        for row in reader.rows::<LabelRow>(rows)? {
            let row = row?;
            let motion = tally.motions.get_mut(row.motion);
            *motion.ok_or_else(|| {
                Error::damaged(reader.dir(), "a motion of the configuration in each row", row.motion)
            })? += 1;
            tally.add(&row);
        }
        Ok(tally)
    }

    fn add(&mut self, row: &LabelRow) {
        *self.target_shapes.entry(row.target_shape.clone()).or_default() += 1;
        *self.obstacles.entry(row.obstacles).or_default() += 1;
        for (stats, numbers) in self.hands.as_flattened_mut().iter_mut().zip(row.hands.as_flattened()) {
            add_each(stats, numbers);
        }
        if let Some(twist) = &row.twist {
            self.twists.add(twist);
        }
        for &value in &row.values {
            self.maps.add(value.into());
        }
    }

    /// Adds the tally of the rows that follow.
    fn merge(&mut self, other: Self) {
        for (ours, theirs) in self.motions.iter_mut().zip(other.motions) {
            *ours += theirs;
        }
        for (shape, rows) in other.target_shapes {
            *self.target_shapes.entry(shape).or_default() += rows;
        }
        for (obstacles, rows) in other.obstacles {
            *self.obstacles.entry(obstacles).or_default() += rows;
        }
        for (ours, theirs) in self.hands.as_flattened_mut().iter_mut().zip(other.hands.as_flattened()) {
            merge_each(ours, theirs);
        }
        self.twists.merge(other.twists);
        self.maps.merge(&other.maps);
    }

    /// Converts the tally of a whole dataset to its statistics.
    fn finish(self, config: &DatasetConfig, bytes: ByteCounts) -> DatasetStatistics {
        let motions = config.motions.iter().zip(self.motions);
        let motions = motions.map(|(motion, rows)| MotionCount {
            name: motion.name.clone(),
            share: motion.share,
            rows,
        });
        let names: &[_] = if self.hands.len() == 2 { &["current", "goal"] } else { &["hand"] };
        let hands = names.iter().zip(&self.hands).map(|(&name, [pose, joints])| HandStatistics {
            name: name.to_owned(),
            pose: PoseStats::new(pose),
            joints_rad: joints.map(|joint| joint.summary()),
        });
        let arm = left_arm(&config.world.arm);
        let (lower, upper) = (arm.limits().lower, arm.limits().upper);
        DatasetStatistics {
            motions: motions.collect(),
            target_shapes: self.target_shapes,
            obstacles: self.obstacles,
            hands: hands.collect(),
            joint_limits_rad: std::array::from_fn(|joint| [lower[joint], upper[joint]]),
            labels: match config.kind {
                Kind::Approach => LabelStatistics::Twist(self.twists.finish()),
                Kind::Avoidance => LabelStatistics::Values(self.maps.finish()),
            },
            bytes,
        }
    }
}

impl TwistTally {
    fn add(&mut self, twist: &[f64; 6]) {
        add_each(&mut self.axes, twist);
        for (norms, half) in self.norms.iter_mut().zip(twist.chunks_exact(3)) {
            norms.push(half.iter().map(|v| v * v).sum::<f64>().sqrt());
        }
    }

    fn merge(&mut self, other: Self) {
        merge_each(&mut self.axes, &other.axes);
        for (ours, theirs) in self.norms.iter_mut().zip(other.norms) {
            ours.extend(theirs);
        }
    }

    fn finish(self) -> TwistStatistics {
        let [translation_m, rotation_rad] = self.norms.map(NormStatistics::new);
        TwistStatistics { axes: PoseStats::new(&self.axes), translation_m, rotation_rad }
    }
}

impl MapTally {
    fn add(&mut self, value: f64) {
        self.values.add(value);
        self.tenths[((value * 10.0) as usize).min(9)] += 1;
        self.free += u64::from(value <= 0.0);
        self.blocked += u64::from(value >= BLOCKED);
    }

    fn merge(&mut self, other: &Self) {
        self.values.merge(&other.values);
        for (ours, theirs) in self.tenths.iter_mut().zip(other.tenths) {
            *ours += theirs;
        }
        self.free += other.free;
        self.blocked += other.blocked;
    }

    fn finish(&self) -> MapStatistics {
        let all = self.tenths.iter().sum::<u64>() as f64;
        MapStatistics {
            summary: self.values.summary(),
            free: self.free as f64 / all,
            blocked: self.blocked as f64 / all,
            tenths: self.tenths.map(|count| count as f64 / all),
        }
    }
}

fn add_each(stats: &mut [RunningStats; 6], numbers: &[f64; 6]) {
    for (stats, &number) in stats.iter_mut().zip(numbers) {
        stats.add(number);
    }
}

fn merge_each(ours: &mut [RunningStats; 6], theirs: &[RunningStats; 6]) {
    for (ours, theirs) in ours.iter_mut().zip(theirs) {
        ours.merge(theirs);
    }
}
