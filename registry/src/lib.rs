//! Versioned, immutable checkpoints in a create-only store.
//!
//! The promise: what is published never changes, and what is delivered is what was published. Nothing in a registry is ever
//! updated. Each object is either a blob, named by its own digest, or a numbered pointer, created once.
//!
//! ```text
//! registry.json                             format of the registry
//! blobs/sha256/ab/abcdef...                 files, configurations, manifests, events and attachments by digest
//! models/<name>/versions/000007             digest of the manifest of version 7
//! models/<name>/events/000007/000001        digest of the first event of version 7: a yank, an attachment
//! models/<name>/events/<alias>/000012       digest of the 12th event of an alias: the version that it names since then
//! ```
//!
//! A pointer is a text file with one digest. The number finds a document, and the digest proves it. Publishing writes the blobs
//! first and the pointer last, so an interrupted publication leaves only blobs that nothing names. Of two simultaneous
//! publications, one gets the number and the other takes the next. What changes after publication (aliases, yanks, attachments) is
//! recorded as events, each of which names the digest of the previous one. Only garbage is ever deleted: blobs that nothing names
//! any more.
//!
//! Manifests are OCI image manifests with the media types of the CNCF model format
//! (<https://github.com/modelpack/model-spec>). A manifest does not contain the version's number, so a copy in another registry has
//! the same digest. A version leaves the registry as a folder, an OCI image layout or a folder of the Hugging Face Hub, and the
//! latter two can be imported. Signatures follow OpenSSF Model Signing.
//!
//! A registry is a folder or, with the feature `s3`, a prefix in a bucket, in the same layout. Before it is created, a probe tests
//! the one promise that everything depends on: the store creates an object only if there is none.
//!
//! Foreign input is not trusted. Paths stay inside the folder that they are delivered to, sizes and headers of weights are checked,
//! and no symbolic link in a registry is followed. `fuzz/` states what the parsers promise.
//!
//! Data walks through the modules from bottom to top: `store` (folder or bucket), `model` (documents), `registry` (opening and
//! loading), `events` (logs of aliases and versions), `operations` (publish, pull, verify...), `exchange` (other formats). This crate
//! knows files, not networks. It has no clock and no randomness.
#![forbid(unsafe_code)]

mod digest;
mod error;
mod events;
mod exchange;
#[cfg(test)]
mod fixture;
#[cfg(any(test, fuzzing))]
pub mod fuzzing;
mod model;
mod operations;
mod outcome;
mod problem;
mod registry;
mod signature;
mod store;

pub use digest::{Digest, InvalidDigest};
pub use error::{Error, Result};
pub use events::alias::Precondition;
pub use events::attachment::Attachment;
pub use events::attachment::{Evaluation, Metric};
pub use model::{
    AliasName, Descriptor, Event, EventKind, Lineage, Manifest, ModelName, ModelRef, ModelVersion, Note,
    Provenance, Selector, Target,
};
pub use operations::{Change, Copied, Difference, GRACE, Garbage, MetricChange, Model, Verification};
pub use outcome::Outcome;
pub use problem::{Fault, Problem};
pub use registry::Registry;
pub use signature::{PrivateKey, PublicKey, Signature, SignedFiles};
pub use store::location::Location;
