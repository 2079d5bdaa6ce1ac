//! From datasets to batches.
//!
//! [`Examples`] reads the labels of datasets and opens their images, either decoded once (`image_cache`) or for each batch
//! (`image_stream`), at the size of the network's input (`input`). A [`Split`] orders them, a batch (`batch`) collects the
//! pixels of a step, and the targets (`targets`) its standardized labels.

pub(crate) mod batch;
pub(crate) mod camera;
pub(crate) mod examples;
pub(crate) mod image_cache;
pub(crate) mod image_stream;
pub(crate) mod input;
pub(crate) mod split;
pub(crate) mod standardization;
pub(crate) mod targets;

pub use self::examples::{Examples, Source};
pub use self::split::Split;
pub use self::standardization::Standardization;
