//! Versioned, immutable checkpoints in a create-only store
