//! The documents of a registry, their names and their parts: pure data, without a store.

pub(crate) mod checkpoint;
mod event;
mod manifest;
mod reference;
pub(crate) mod safetensors;
mod version;

pub use event::{Event, EventKind, Note, Target};
pub(crate) use manifest::{ARTIFACT_TYPE, MANIFEST_TYPE, model_config};
pub use manifest::{Descriptor, Lineage, Manifest, Provenance};
pub use reference::{AliasName, ModelName, ModelRef, Selector};
pub use version::ModelVersion;
