//! Checkpoints: everything needed to use a network, in one folder that is published by rename.
//!
//! ```text
//! model.json            architecture, meaning of the output, camera, data, metrics, digest of the weights
//! weights.safetensors   the weights, with readable names
//! config.json           the architecture for other programs: layers, input, output
//! config.toml           the training configuration
//! training.json         only in `last`: the training state
//! optimizer.safetensors only in `last`: the moments of the optimizer
//! ```
//!
//! A run saves its state (`save`) and resumes from it (`training_state`). [`ApproachModel`] and [`AvoidModel`] use the
//! network, [`WarmStart`] starts a run from it, and [`ModelInfo`] and [`Description`] describe it.

pub(crate) mod description;
pub(crate) mod files;
pub(crate) mod lineage;
pub(crate) mod load;
pub(crate) mod model;
pub(crate) mod model_info;
pub(crate) mod pretrained;
pub(crate) mod publish;
pub(crate) mod save;
pub(crate) mod training_state;
pub(crate) mod warm_start;

pub use self::description::Description;
pub use self::files::{MODEL, WEIGHTS};
pub use self::lineage::{Parent, Program, Version};
pub use self::load::Checkpoint;
pub use self::model::{ApproachModel, AvoidModel};
pub use self::model_info::ModelInfo;
pub use self::pretrained::{Imported, OtherShape};
pub use self::warm_start::WarmStart;
