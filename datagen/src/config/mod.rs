//! Dataset configuration: the contents of a file in `configs/datasets/`. Every key is required; there are no defaults.

mod motion;
mod objects;
mod randomization;
mod rejection;
mod validation;

pub use motion::{MotionConfig, RangeConfig};
pub use objects::{ObstacleConfig, ShapeName, TargetConfig};
pub use randomization::{
    CameraSpread, ColorSpread, LightSpread, RandomizationConfig, TextureConfig, TextureRange,
};
pub use rejection::{Obstruction, RejectionConfig};
pub use validation::{ConfigError, Result};

use serde::{Deserialize, Serialize};
use std::fmt;
use validation::require;
use world::WorldConfig;

/// Configuration of one dataset.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetConfig {
    /// Name: lowercase letters, digits, `_` and `-`.
    pub name: String,
    /// License of the data, as a Hugging Face identifier.
    pub license: String,
    /// Kind of the rows.
    pub kind: Kind,
    /// Seed of all random draws; 0 is valid and not special.
    pub seed: u64,
    /// Number of rows.
    pub count: u64,
    /// Rows per file, the unit of commit.
    pub rows_per_shard: u64,
    /// Virtual environment.
    pub world: WorldConfig,
    /// Object to be grasped.
    pub target: TargetConfig,
    /// Obstacles on the table.
    pub obstacles: ObstacleConfig,
    /// Motions: pairs of hand pose ranges, or single ranges for avoidance maps.
    pub motions: Vec<MotionConfig>,
    /// Conditions that an example must satisfy.
    pub rejection: RejectionConfig,
    /// Domain randomization, beyond the paper.
    pub randomization: RandomizationConfig,
}

/// Kind of the rows of a dataset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Two hand poses, their images and the motion between them, for `CNN_approach` (paper, Section 6.2).
    Approach,
    /// One hand pose, its image and its avoidance map, for `CNN_avoid` (paper, Section 6.3).
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

impl DatasetConfig {
    /// Parses and validates a table in which `extends` is already resolved.
    pub fn from_table(table: toml::Table) -> Result<Self> {
        let config: Self = table.try_into()?;
        config.validate()?;
        Ok(config)
    }

    /// Number of files.
    pub fn shards(&self) -> u64 {
        self.count.div_ceil(self.rows_per_shard)
    }

    /// Checks every value; an error names the key.
    pub fn validate(&self) -> Result<()> {
        let named = !self.name.is_empty()
            && self
                .name
                .bytes()
                .all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_' || b == b'-');
        require("name", named, &self.name, "lowercase letters, digits, _ and -")?;
        let licensed = !self.license.is_empty()
            && self
                .license
                .bytes()
                .all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'.' || b == b'-');
        require(
            "license",
            licensed,
            &self.license,
            "lowercase letters, digits, . and -, for example cc0-1.0",
        )?;
        require("count", (1..=100_000_000).contains(&self.count), self.count, "1 to 100000000 rows")?;
        let fits = self.rows_per_shard > 0 && self.shards() <= 100_000;
        require("rows_per_shard", fits, self.rows_per_shard, "at least 1, and no more than 100000 files")?;
        self.world.validate()?;
        self.target.validate()?;
        self.obstacles.validate()?;
        MotionConfig::validate(&self.motions)?;
        for (i, motion) in self.motions.iter().enumerate() {
            let found = if motion.goal.is_some() { "a range" } else { "nothing" };
            let (fits, expected) = match self.kind {
                Kind::Approach => (motion.goal.is_some(), "a range, because kind = \"approach\""),
                Kind::Avoidance => (motion.goal.is_none(), "nothing, because kind = \"avoidance\""),
            };
            require(format!("motions[{i}].goal"), fits, found, expected)?;
        }
        self.rejection.validate()?;
        self.randomization.validate(&self.world.light)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture;

    #[test]
    fn the_datasets_have_the_sizes_of_the_paper() {
        for (name, kind, count) in [
            ("a", Kind::Approach, 20_000),
            ("b", Kind::Approach, 20_000),
            ("c", Kind::Approach, 12_000),
            ("avoid", Kind::Avoidance, 20_000),
        ] {
            let config = DatasetConfig::from_table(fixture::table(name)).unwrap();
            assert_eq!((config.kind, config.count), (kind, count), "{name}");
        }
    }

    #[test]
    fn a_missing_or_unknown_key_is_named() {
        let mut table = fixture::table("a");
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
    fn an_invalid_value_is_named() {
        type Change = fn(&mut DatasetConfig);
        let refused = |change: Change| {
            let mut config = fixture::config("c", 1);
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
