//! What can go wrong with servo sessions. How a session ends is no error but an [`Outcome`](crate::trace::Outcome).

/// An error of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A value of the configuration that makes no evaluation.
    #[error("{key} = {value}: expected {expected}")]
    Config {
        /// The key, with the tables it stands in.
        key: String,
        /// What it says.
        value: String,
        /// What it may say.
        expected: &'static str,
    },
    /// The environment of the configuration cannot be built.
    #[error(transparent)]
    World(#[from] world::Error),
    /// Part of the configuration is refused by data generation, whose placement sessions use.
    #[error(transparent)]
    Placement(#[from] datagen::ConfigError),
    /// A failure to read a dataset or to encode an image.
    #[error(transparent)]
    Dataset(#[from] datagen::Error),
    /// The start and goal of a session cannot be drawn.
    #[error("session {index}: {source}")]
    Trial {
        /// Index of the session.
        index: usize,
        /// Why.
        source: datagen::Rejections,
    },
    /// The obstacles leave no room for the hand at start and goal.
    #[error(
        "session {index}: in {tries} draws the hand never kept clearance_mm from the obstacles at start and goal; lower it, or \
         raise obstacles.distance_mm"
    )]
    Crowded {
        /// Index of the session.
        index: usize,
        /// Draws made.
        tries: u32,
    },
    /// An avoidance map that does not belong to this world's measuring points.
    #[error(
        "the avoidance map has {found} values, but world.avoidance.measuring_points = {expected}; use a model that was \
         trained with this world"
    )]
    MapSize {
        /// Values of the map.
        found: usize,
        /// Measuring points of the world.
        expected: usize,
    },
    /// A policy that could not answer.
    #[error("policy: {0}")]
    Policy(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The caller asked to stop.
    #[error("stopped after {done} of {total} sessions")]
    Interrupted {
        /// Sessions that were finished.
        done: usize,
        /// Sessions asked for.
        total: usize,
    },
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;
