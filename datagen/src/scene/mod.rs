//! Random scenes with hand poses, drawn until they satisfy a configuration (paper, Section 6.2).
//!
//! [`Sampler`] draws a [`Placement`]: a scene and the hand poses in it. [`Randomizer`] then varies its appearance. Datasets
//! and servo sessions use the same code.

mod placement;
mod pose_range;
mod random;
mod randomizer;
mod rejection;
mod sampler;

pub use placement::{HandPlacement, Placement};
pub use pose_range::PoseRange;
pub use random::stream;
pub use randomizer::Randomizer;
pub use rejection::{Reason, Rejections};
pub use sampler::Sampler;
