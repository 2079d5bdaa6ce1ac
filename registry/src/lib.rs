//! Versioned, immutable checkpoints in a create-only store.
//!
//! The promise: what is published never changes, and what is delivered is what was published. Nothing in a registry is
//! ever updated; each object is either named by its own digest or created once under a number.
//!
//! ```text
//! registry.json                                   format of the registry, created once
//! blobs/sha256/ab/abcdef...                       files, configurations, manifests and entries, named by their digest
//! models/<name>/versions/000007.json              manifest of version 7, created once: of two writers, one takes 8
//! models/<name>/aliases/<alias>/000000012.json    what the alias means since its 12th change
//! models/<name>/yanks/000003/000000001.json       that and why version 3 is yanked, or no longer
//! models/<name>/attachments/000003/000000001.json a signature or an evaluation of version 3, made after it was published
//! ```
//!
//! Publishing writes blobs first and the numbered manifest last, so an interrupted publication leaves only blobs that no
//! version names. A numbered manifest also stands among the blobs, byte for byte: the number finds it, the digest
//! proves it. So do entries about aliases, yanked versions and attachments, each of which also names the digest of the one
//! before. What nothing names any more is garbage, the only thing that is ever deleted. Manifests are OCI image manifests
//! with the media types of the CNCF model format (<https://github.com/modelpack/model-spec>). A version leaves the registry
//! as a folder, an OCI image layout or a folder for the Hugging Face Hub, comes back from the latter two, and is signed by
//! the rules of OpenSSF Model Signing.
//!
//! A registry is a folder or, with the feature `s3`, a place in a bucket, in the same layout. Whoever creates one first sees
//! whether the store keeps the one promise that all this rests on: that an object is created only where there is none.
//!
//! Nothing that comes from elsewhere is taken at its word: paths stay inside the folder that they are delivered to, sizes and
//! headers of weights are checked, and in a registry on a folder no symbolic link is followed. What the parsers promise is in
//! `fuzz/`.
//!
//! This crate knows files, not networks that learn; it has no clock and no randomness.
#![forbid(unsafe_code)]

mod alias;
mod attachment;
#[cfg(feature = "s3")]
mod bucket;
mod card;
mod checkpoint;
mod diff;
mod digest;
mod error;
mod evaluation;
#[cfg(test)]
mod fixture;
#[cfg(any(test, fuzzing))]
pub mod fuzzing;
mod gc;
mod huggingface;
mod import;
mod ingest;
mod location;
mod log;
mod manifest;
mod name;
mod oci;
mod plain;
mod probe;
mod problem;
mod publish;
mod pull;
#[cfg(test)]
mod quirk;
mod reference;
mod registry;
mod safetensors;
mod signature;
mod store;
mod verify;
mod yank;

pub use alias::AliasName;
pub use attachment::{Attached, Attachment};
pub use diff::{Change, Compared, Difference};
pub use digest::Digest;
pub use error::{Error, Result};
pub use evaluation::{Evaluation, Metric};
pub use gc::{GRACE, Garbage};
pub use location::Location;
pub use log::{Entry, Expect, Remark, Target};
pub use manifest::{Descriptor, Lineage, Manifest, Provenance};
pub use name::ModelName;
pub use problem::{Fault, Problem};
pub use publish::Published;
pub use pull::Pulled;
pub use reference::{ModelRef, Selector};
pub use registry::{Model, ModelVersion, Registry};
pub use signature::{PrivateKey, PublicKey, Signature, SignedFiles};
pub use verify::Verification;
