//! Selection of the rows to show.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;

/// Returns `count` of `rows` rows, evenly spread, or all if there are fewer.
pub fn evenly_spread(rows: u64, count: u64) -> Vec<u64> {
    let count = count.min(rows);
    (0..count).map(|i| (u128::from(2 * i + 1) * u128::from(rows) / u128::from(2 * count)) as u64).collect()
}

/// Returns `count` of `rows` rows, drawn at random without replacement, in ascending order, or all if there are fewer.
pub fn drawn(rows: u64, count: u64, seed: u64) -> Vec<u64> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut drawn = BTreeSet::new();
    while (drawn.len() as u64) < count.min(rows) {
        drawn.insert(rng.random_range(0..rows));
    }
    drawn.into_iter().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_spread_evenly() {
        assert_eq!(evenly_spread(100, 4), [12, 37, 62, 87]);
        assert_eq!(evenly_spread(3, 12), [0, 1, 2]);
        assert_eq!(evenly_spread(u64::MAX, 1), [u64::MAX / 2]);
    }

    #[test]
    fn drawn_rows_are_distinct_and_depend_on_the_seed() {
        let rows = drawn(1000, 30, 5);
        assert!(rows.len() == 30 && rows.is_sorted_by(|a, b| a < b) && rows[29] < 1000, "{rows:?}");
        assert_eq!(rows, drawn(1000, 30, 5));
        assert_ne!(rows, drawn(1000, 30, 6));
        assert_eq!(drawn(3, 12, 0), [0, 1, 2]);
    }
}
