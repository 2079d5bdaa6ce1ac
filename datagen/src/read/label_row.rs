//! The row type of statistics.

use crate::config::Kind;
use crate::error::Result;
use crate::row::{Batch, MotionRow, Row};

/// The columns that statistics are computed from: everything except images and scene.
#[derive(Clone)]
pub(super) struct LabelRow {
    pub(super) motion: usize,
    pub(super) target_shape: String,
    pub(super) obstacles: u64,
    /// Pose and joint angles at each hand pose.
    pub(super) hands: Vec<[[f64; 6]; 2]>,
    /// Twist of an approach.
    pub(super) twist: Option<[f64; 6]>,
    /// Values of an avoidance map; empty for an approach.
    pub(super) values: Vec<f32>,
}

impl Row for LabelRow {
    const KIND: Option<Kind> = None;
    /// Columns of both kinds of dataset: twists with two poses, or maps with one.
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
        let is_approach = batch.has("twist");
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
