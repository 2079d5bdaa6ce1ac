//! Everything that a step changes.

use crate::checkpoint::training_state::TrainingState;
use crate::network::Network;
use crate::optimizer::adamw::AdamW;

/// A network in training.
pub(crate) struct Learner {
    pub(crate) network: Network,
    pub(crate) optimizer: AdamW,
    pub(crate) state: TrainingState,
}
