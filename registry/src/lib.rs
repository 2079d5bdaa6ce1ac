//! Versioned, immutable checkpoints in a create-only store.
//!
//! The promise: what is published never changes, and what is delivered is what was published. Nothing in a registry is
//! ever updated; each object is either named by its own digest or created once under a number.
//!
//! ```text
//! registry.json                              format of the registry, created once
//! blobs/sha256/ab/abcdef...                  files, configurations and manifests, named by their digest
//! models/<name>/versions/000007.json         manifest of version 7, created once: of two writers, one takes 8
//! ```
//!
//! Publishing writes blobs first and the numbered manifest last, so an interrupted publication leaves only blobs that no
//! version names. A numbered manifest also stands among the blobs, byte for byte: the number finds it, the digest
//! proves it. Manifests are OCI image manifests with the media types of the CNCF model format
//! (<https://github.com/modelpack/model-spec>).
//!
//! A registry is a folder or, with the feature `s3`, a place in a bucket, in the same layout. Whoever creates one first sees
//! whether the store keeps the one promise that all this rests on: that an object is created only where there is none.
//!
//! This crate knows files, not networks that learn; it has no clock and no randomness.
#![forbid(unsafe_code)]

#[cfg(feature = "s3")]
mod bucket;
mod checkpoint;
mod digest;
mod error;
#[cfg(test)]
mod fixture;
mod location;
mod manifest;
mod name;
mod probe;
mod problem;
mod publish;
mod pull;
#[cfg(test)]
mod quirk;
mod reference;
mod registry;
mod store;
mod verify;

pub use digest::Digest;
pub use error::{Error, Result};
pub use location::Location;
pub use manifest::{Descriptor, Lineage, Manifest, Provenance};
pub use name::ModelName;
pub use problem::{Fault, Problem};
pub use publish::Published;
pub use pull::Pulled;
pub use reference::{ModelRef, Selector};
pub use registry::{Model, ModelVersion, Registry};
pub use verify::Verification;
