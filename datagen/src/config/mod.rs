//! What a file in `configs/datasets/` says. It is complete: no key has a default.

use crate::error::{Error, Result};
use crate::object_config::{ObstacleConfig, TargetConfig};
use crate::randomization_config::RandomizationConfig;
use serde::{Deserialize, Serialize};
use std::fmt;
use world::WorldConfig;

/// One dataset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetConfig {
    /// Name: lower case letters, digits, `_` and `-`.
    pub name: String,
    /// License of the data, as Hugging Face spells it.
    pub license: String,
    /// What a row is.
    pub kind: Kind,
    /// Seed of all random draws; 0 is a seed like others.
    pub seed: u64,
    /// Number of rows.
    pub count: u64,
    /// Rows in a file; the unit of commit.
    pub rows_per_shard: u64,
    /// The virtual environment.
    pub world: WorldConfig,
    /// The object to be grasped.
    pub target: TargetConfig,
    /// What stands in the way.
    pub obstacles: ObstacleConfig,
    /// Pose ranges.
    pub motions: Vec<MotionConfig>,
    /// What a drawn example must fulfill.
    pub rejection: RejectionConfig,
    /// What differs from example to example beyond the paper.
    pub randomization: RandomizationConfig,
}

/// What a row is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Two hand poses, two images and the change between them, for `CNN_approach` (paper, Section 6.2).
    Approach,
    /// One hand pose, one image and its avoidance map, for `CNN_avoid` (paper, Section 6.3).
    Avoidance,
}

impl fmt::Display for Kind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Approach => "approach",
            Self::Avoidance => "avoidance",
        })
    }
}

/// Where the hand is before and after a motion.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionConfig {
    /// Name, as it stands in the rows.
    pub name: String,
    /// Share of the examples; all shares add up to 1.
    pub share: f64,
    /// Poses of the current image.
    pub current: RangeConfig,
    /// Poses of the goal image; none in a dataset of avoidance maps.
    pub goal: Option<RangeConfig>,
}

impl MotionConfig {
    /// Ranges of the hand poses, in the order in which rows hold them.
    pub fn ranges(&self) -> impl Iterator<Item = &RangeConfig> {
        std::iter::once(&self.current).chain(&self.goal)
    }
}

/// A range of hand poses (paper, Section 6.2): half-widths around the pose that looks straight down from a reference point
/// above the target's centre; axes of the robot frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RangeConfig {
    /// Height of the reference point above the target's centre.
    pub reference_mm: f64,
    /// Forward and back.
    pub x_mm: f64,
    /// Left and right.
    pub y_mm: f64,
    /// Up and down.
    pub z_mm: f64,
    /// `φ`, about x.
    pub phi_deg: f64,
    /// `θ`, about y.
    pub theta_deg: f64,
    /// `ψ`, about z.
    pub psi_deg: f64,
}

/// What a drawn example must fulfill beside being within the arm's reach.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RejectionConfig {
    /// Draws per example before it is given up with an error.
    pub tries: u32,
    /// Least share of each image that shows the target, whose centre must be in the image, too.
    pub min_target_area: f64,
    /// What the hand must not touch in any of its poses.
    pub clear_of: Vec<Obstruction>,
}

/// Something that the hand can touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Obstruction {
    /// The table.
    Table,
    /// Any obstacle.
    Obstacles,
    /// The target.
    Target,
}

impl DatasetConfig {
    /// From a table in which `extends` is already resolved; validates.
    pub fn from_table(table: toml::Table) -> Result<Self> {
        let config: Self = table.try_into()?;
        config.validate()?;
        Ok(config)
    }

    /// Number of files.
    pub fn shards(&self) -> u64 {
        self.count.div_ceil(self.rows_per_shard)
    }

    /// Refuses values that make no dataset; names the key.
    pub fn validate(&self) -> Result<()> {
        let named = !self.name.is_empty()
            && self
                .name
                .bytes()
                .all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_' || b == b'-');
        require("name", named, &self.name, "lower case letters, digits, _ and -")?;
        let licensed = !self.license.is_empty()
            && self
                .license
                .bytes()
                .all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'.' || b == b'-');
        require("license", licensed, &self.license, "lower case letters, digits, . and -, as cc0-1.0")?;
        require("count", (1..=100_000_000).contains(&self.count), self.count, "1 to 100000000 rows")?;
        let fits = self.rows_per_shard > 0 && self.shards() <= 100_000;
        require("rows_per_shard", fits, self.rows_per_shard, "at least 1, and at most 100000 files")?;
        self.world.validate()?;
        self.target.validate()?;
        self.obstacles.validate()?;
        MotionConfig::validate(&self.motions)?;
        for (i, motion) in self.motions.iter().enumerate() {
            let found = if motion.goal.is_some() { "a range" } else { "nothing" };
            let (fits, expected) = match self.kind {
                Kind::Approach => (motion.goal.is_some(), "a range, as kind = \"approach\""),
                Kind::Avoidance => (motion.goal.is_none(), "nothing, as kind = \"avoidance\""),
            };
            require(format!("motions[{i}].goal"), fits, found, expected)?;
        }
        self.rejection.validate()?;
        self.randomization.validate(&self.world.light)
    }
}

impl MotionConfig {
    /// Refuses values that make no motions; names the key.
    pub fn validate(motions: &[Self]) -> Result<()> {
        for (i, motion) in motions.iter().enumerate() {
            require(format!("motions[{i}].name"), !motion.name.is_empty(), &motion.name, "a name")?;
            require(format!("motions[{i}].share"), motion.share > 0.0, motion.share, "more than 0")?;
            motion.current.validate(&format!("motions[{i}].current"))?;
            if let Some(goal) = &motion.goal {
                goal.validate(&format!("motions[{i}].goal"))?;
            }
        }
        let total: f64 = motions.iter().map(|motion| motion.share).sum();
        require("motions", (total - 1.0).abs() < 1e-9, format!("shares that add up to {total}"), "1")
    }
}

impl RangeConfig {
    fn validate(&self, key: &str) -> Result<()> {
        let distances = [
            ("reference_mm", self.reference_mm),
            ("x_mm", self.x_mm),
            ("y_mm", self.y_mm),
            ("z_mm", self.z_mm),
        ];
        for (name, value) in distances {
            require(format!("{key}.{name}"), (0.0..=2000.0).contains(&value), value, "0 to 2000")?;
        }
        // Within these, the six numbers of a pose are unique.
        let angles = [
            ("phi_deg", self.phi_deg, 180.0, "0 to 180"),
            ("theta_deg", self.theta_deg, 80.0, "0 to 80"),
            ("psi_deg", self.psi_deg, 180.0, "0 to 180"),
        ];
        for (name, value, limit, expected) in angles {
            require(format!("{key}.{name}"), (0.0..=limit).contains(&value), value, expected)?;
        }
        Ok(())
    }
}

impl RejectionConfig {
    /// Refuses values that accept nothing; names the key.
    pub fn validate(&self) -> Result<()> {
        require("rejection.tries", (1..=1_000_000).contains(&self.tries), self.tries, "1 to 1000000")?;
        let area = self.min_target_area;
        require("rejection.min_target_area", (0.0..1.0).contains(&area), area, "at least 0 and less than 1")
    }
}

pub(crate) fn require_interval(
    key: impl Into<String>,
    value: [f64; 2],
    within: [f64; 2],
    expected: &'static str,
) -> Result<()> {
    let holds = within[0] <= value[0] && value[0] <= value[1] && value[1] <= within[1];
    require(key, holds, format!("{value:?}"), expected)
}

pub(crate) fn require(
    key: impl Into<String>,
    holds: bool,
    value: impl fmt::Display,
    expected: &'static str,
) -> Result<()> {
    if holds { Ok(()) } else { Err(Error::Config { key: key.into(), value: value.to_string(), expected }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tiny;

    #[test]
    fn the_datasets_have_the_sizes_of_the_paper() {
        for (name, kind, count) in [
            ("a", Kind::Approach, 20_000),
            ("b", Kind::Approach, 20_000),
            ("c", Kind::Approach, 12_000),
            ("avoid", Kind::Avoidance, 20_000),
        ] {
            let config = DatasetConfig::from_table(tiny::table(name)).unwrap();
            assert_eq!((config.kind, config.count), (kind, count), "{name}");
        }
    }

    #[test]
    fn a_missing_or_unknown_key_is_named() {
        let mut table = tiny::table("a");
        let seed = table.remove("seed").unwrap();
        assert!(
            DatasetConfig::from_table(table.clone())
                .unwrap_err()
                .to_string()
                .contains("missing field `seed`")
        );
        table.insert("sead".to_owned(), seed);
        assert!(DatasetConfig::from_table(table).unwrap_err().to_string().contains("unknown field `sead`"));
    }

    #[test]
    fn a_value_that_makes_no_sense_is_named() {
        type Change = fn(&mut DatasetConfig);
        let refused = |change: Change| {
            let mut config = tiny::config("c", 1);
            change(&mut config);
            config.validate().unwrap_err().to_string()
        };
        let cases: [(Change, &str); 11] = [
            (|c| c.name = "../a".to_owned(), "name = ../a"),
            (|c| c.count = 0, "count = 0"),
            (|c| c.rows_per_shard = 0, "rows_per_shard = 0"),
            (|c| c.target.x_mm = [400.0, 300.0], "target.x_mm = [400.0, 300.0]"),
            (|c| c.target.short_side_mm = [f64::NAN, 1.0], "target.short_side_mm = [NaN, 1.0]"),
            (|c| c.obstacles.long_side_mm = [40.0, 50.0], "obstacles.long_side_mm = [40.0, 50.0]"),
            (|c| c.motions[1].share = 0.4, "motions = shares that add up to 0.9"),
            (|c| c.motions[1].goal = None, "motions[1].goal = nothing"),
            (|c| c.license = "CC0 1.0".to_owned(), "license = CC0 1.0"),
            (|c| c.motions[0].current.theta_deg = 90.0, "motions[0].current.theta_deg = 90"),
            (|c| c.kind = Kind::Avoidance, "motions[0].goal = a range"),
        ];
        for (change, expected) in cases {
            let message = refused(change);
            assert!(message.starts_with(expected), "{message}");
        }
    }
}
