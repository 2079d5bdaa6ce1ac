//! Networks, training loop and checkpoints
