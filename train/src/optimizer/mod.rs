//! One step of training: a loss, its gradients, and an optimizer that applies them at a scheduled learning rate.

pub mod adamw;
pub mod gradients;
pub mod loss;
pub(crate) mod one_cycle;
pub(crate) mod phase;
