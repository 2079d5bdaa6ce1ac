//! Counting rows for [`crate::statistics`]: a part of the dataset at a time, parts joined in order.

use crate::config::{DatasetConfig, Kind};
use crate::error::{Error, Result};
use crate::reader::DatasetReader;
use crate::row::{Batch, MotionRow, Row};
use crate::spread::Tally;
use crate::statistics::{
    BLOCKED, ByteCounts, DatasetStatistics, HandStatistics, LabelStatistics, MapStatistics, MotionCount,
    NormStatistics, PoseSpreads, TwistStatistics,
};
use std::collections::BTreeMap;
use std::ops::Range;
use world::hiro::left_arm;

/// What is counted of a row: all but images and scene.
#[derive(Clone)]
struct LabelRow {
    motion: usize,
    target_shape: String,
    obstacles: u64,
    /// Pose and joint angles of the hand, for each of its poses.
    hands: Vec<[[f64; 6]; 2]>,
    /// Of an approach.
    twist: Option<[f64; 6]>,
    /// Of an avoidance map; empty without one.
    values: Vec<f32>,
}

impl Row for LabelRow {
    const KIND: Option<Kind> = None;
    /// A dataset has either twists with two poses or maps with one.
    const COLUMNS: &'static [&'static str] = &[
        "index",
        "motion",
        "target_shape",
        "obstacles",
        "twist",
        "pose_current",
        "joints_current",
        "pose_goal",
        "joints_goal",
        "values",
        "pose",
        "joints",
    ];

    fn decode(batch: &Batch<'_>) -> Result<Vec<Self>> {
        let is_approach = batch.columns.column_by_name("twist").is_some();
        let names: &[_] = if is_approach {
            &[["pose_current", "joints_current"], ["pose_goal", "joints_goal"]]
        } else {
            &[["pose", "joints"]]
        };
        let sixes = |[pose, joints]: &[&str; 2]| Ok([batch.doubles(pose)?, batch.doubles(joints)?]);
        let hands = names.iter().map(sixes).collect::<Result<Vec<_>>>()?;
        let twists = if is_approach { batch.doubles("twist")? } else { Vec::new() };
        let maps = if is_approach { Vec::new() } else { batch.maps("values")? };
        let (motions, obstacles) = (MotionRow::decode(batch)?, batch.counts("obstacles")?);
        let shapes = batch.texts("target_shape")?;
        let row = |i: usize| Self {
            motion: motions[i].motion,
            target_shape: shapes.value(i).to_owned(),
            obstacles: obstacles.value(i),
            hands: hands.iter().map(|[poses, joints]| [poses[i], joints[i]]).collect(),
            twist: twists.get(i).copied(),
            values: maps.get(i).map(|map| map.to_vec()).unwrap_or_default(),
        };
        Ok((0..batch.rows()).map(row).collect())
    }
}

/// What was counted of some rows.
pub(crate) struct Counts {
    motions: Vec<u64>,
    target_shapes: BTreeMap<String, u64>,
    obstacles: BTreeMap<u64, u64>,
    hands: Vec<[[Tally; 6]; 2]>,
    twists: TwistCounts,
    maps: MapCounts,
}

/// What was counted of twists.
struct TwistCounts {
    axes: [Tally; 6],
    /// Norms of both halves of every twist.
    norms: [Vec<f64>; 2],
}

/// What was counted of the values of avoidance maps.
struct MapCounts {
    values: Tally,
    /// Numbers of values in each tenth of 0 to 1.
    tenths: [u64; 10],
    free: u64,
    blocked: u64,
}

impl Counts {
    /// Of no row.
    pub(crate) fn new(config: &DatasetConfig) -> Self {
        let hands = match config.kind {
            Kind::Approach => 2,
            Kind::Avoidance => 1,
        };
        Self {
            motions: vec![0; config.motions.len()],
            target_shapes: BTreeMap::new(),
            obstacles: BTreeMap::new(),
            hands: vec![[[Tally::EMPTY; 6]; 2]; hands],
            twists: TwistCounts { axes: [Tally::EMPTY; 6], norms: [Vec::new(), Vec::new()] },
            maps: MapCounts { values: Tally::EMPTY, tenths: [0; 10], free: 0, blocked: 0 },
        }
    }

    /// Of some rows.
    pub(crate) fn of(reader: &DatasetReader, rows: Range<u64>) -> Result<Self> {
        let mut counts = Self::new(&reader.info().config);
        for row in reader.rows::<LabelRow>(rows)? {
            let row = row?;
            let motion = counts.motions.get_mut(row.motion);
            *motion.ok_or_else(|| Error::Damaged {
                path: reader.dir().to_owned(),
                expected: "motions of its configuration".to_owned(),
                found: "another motion in a row".to_owned(),
            })? += 1;
            counts.add(&row);
        }
        Ok(counts)
    }

    fn add(&mut self, row: &LabelRow) {
        *self.target_shapes.entry(row.target_shape.clone()).or_default() += 1;
        *self.obstacles.entry(row.obstacles).or_default() += 1;
        for (tallies, numbers) in self.hands.as_flattened_mut().iter_mut().zip(row.hands.as_flattened()) {
            add_each(tallies, numbers);
        }
        if let Some(twist) = &row.twist {
            self.twists.add(twist);
        }
        for &value in &row.values {
            self.maps.add(value.into());
        }
    }

    /// The rows of another part that follows.
    pub(crate) fn join(&mut self, other: Self) {
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
            join_each(ours, theirs);
        }
        self.twists.join(other.twists);
        self.maps.join(&other.maps);
    }

    /// What it says of the whole dataset.
    pub(crate) fn finish(self, config: &DatasetConfig, bytes: ByteCounts) -> DatasetStatistics {
        let motions = config.motions.iter().zip(self.motions);
        let motions = motions.map(|(motion, rows)| MotionCount {
            name: motion.name.clone(),
            share: motion.share,
            rows,
        });
        let names: &[_] = if self.hands.len() == 2 { &["current", "goal"] } else { &["hand"] };
        let hands = names.iter().zip(&self.hands).map(|(&name, [pose, joints])| HandStatistics {
            name: name.to_owned(),
            pose: PoseSpreads::of(pose),
            joints_rad: joints.map(|joint| joint.spread()),
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

impl TwistCounts {
    fn add(&mut self, twist: &[f64; 6]) {
        add_each(&mut self.axes, twist);
        for (norms, half) in self.norms.iter_mut().zip(twist.chunks_exact(3)) {
            norms.push(half.iter().map(|v| v * v).sum::<f64>().sqrt());
        }
    }

    fn join(&mut self, other: Self) {
        join_each(&mut self.axes, &other.axes);
        for (ours, theirs) in self.norms.iter_mut().zip(other.norms) {
            ours.extend(theirs);
        }
    }

    fn finish(self) -> TwistStatistics {
        let [translation_m, rotation_rad] = self.norms.map(NormStatistics::of);
        TwistStatistics { axes: PoseSpreads::of(&self.axes), translation_m, rotation_rad }
    }
}

impl MapCounts {
    fn add(&mut self, value: f64) {
        self.values.add(value);
        self.tenths[((value * 10.0) as usize).min(9)] += 1;
        self.free += u64::from(value <= 0.0);
        self.blocked += u64::from(value >= BLOCKED);
    }

    fn join(&mut self, other: &Self) {
        self.values.join(&other.values);
        for (ours, theirs) in self.tenths.iter_mut().zip(other.tenths) {
            *ours += theirs;
        }
        self.free += other.free;
        self.blocked += other.blocked;
    }

    fn finish(&self) -> MapStatistics {
        let all = self.tenths.iter().sum::<u64>() as f64;
        MapStatistics {
            spread: self.values.spread(),
            free: self.free as f64 / all,
            blocked: self.blocked as f64 / all,
            tenths: self.tenths.map(|count| count as f64 / all),
        }
    }
}

fn add_each(tallies: &mut [Tally; 6], numbers: &[f64; 6]) {
    for (tally, &number) in tallies.iter_mut().zip(numbers) {
        tally.add(number);
    }
}

fn join_each(ours: &mut [Tally; 6], theirs: &[Tally; 6]) {
    for (ours, theirs) in ours.iter_mut().zip(theirs) {
        ours.join(theirs);
    }
}
