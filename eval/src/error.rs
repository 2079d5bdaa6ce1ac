//! Errors of this crate. The way a session ends is not an error but an [`Outcome`](crate::session::outcome::Outcome).

/// An error in an evaluation.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An invalid value in the configuration.
    #[error("{key} = {value}: expected {expected}")]
    Config {
        /// Key, with its tables.
        key: String,
        /// Value found.
        value: String,
        /// Values allowed.
        expected: &'static str,
    },
    /// The configuration describes no valid environment.
    #[error(transparent)]
    World(#[from] world::Error),
    /// The configuration describes no valid placement of target, obstacles and hand.
    #[error(transparent)]
    Placement(#[from] datagen::ConfigError),
    /// No start and goal could be drawn for a session.
    #[error("session {index}: {source}")]
    Trial {
        /// Index of the session.
        index: usize,
        /// Cause.
        source: datagen::Rejections,
    },
    /// No draw left enough clearance between the hand and the obstacles.
    #[error(
        "session {index}: none of {tries} draws kept clearance_mm between the hand and the obstacles at start and goal; lower \
         clearance_mm or raise obstacles.distance_mm"
    )]
    Crowded {
        /// Index of the session.
        index: usize,
        /// Number of draws.
        tries: u32,
    },
    /// The size of an avoidance map differs from the number of measuring points.
    #[error(
        "the avoidance map has {found} values, but world.avoidance.measuring_points = {expected}; use a model trained in this \
         world"
    )]
    MapSize {
        /// Values in the map.
        found: usize,
        /// Measuring points of the world.
        expected: usize,
    },
    /// A policy failed.
    #[error("policy: {0}")]
    Policy(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// The caller stopped the evaluation.
    #[error("stopped after {done} of {total} sessions")]
    Interrupted {
        /// Sessions finished.
        done: usize,
        /// Sessions requested.
        total: usize,
    },
}

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;
