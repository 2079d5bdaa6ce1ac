//! Random streams and uniform draws.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Returns the random stream of one example: a pure function of the seed of its dataset and its index.
pub fn stream(seed: u64, index: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index);
    rng
}

/// Draws uniformly from `[from, to)`; returns `from` if both are equal.
pub(super) fn uniform([from, to]: [f64; 2], rng: &mut ChaCha8Rng) -> f64 {
    from + (to - from) * rng.random::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_of_different_seeds_and_indices_differ() {
        let first = |seed, index| stream(seed, index).random::<u64>();
        assert_eq!(first(1, 2), first(1, 2));
        assert_ne!(first(1, 2), first(1, 3));
        assert_ne!(first(1, 2), first(2, 2));
    }
}
