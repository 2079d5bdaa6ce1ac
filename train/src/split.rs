//! Which examples are learned from, which are held out, and in which order they come: pure functions of the seed.

use std::ops::Range;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Streams of the seed from here on divide the datasets; those below are epochs.
const DIVISION: u64 = 1 << 32;

/// Numbers of the examples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Split {
    /// Learned from: those of each dataset, in an order that is random once and for all.
    pub training: Vec<Vec<usize>>,
    /// Held out, of all datasets, in ascending order.
    pub validation: Vec<usize>,
}

impl Split {
    /// Holds out the same `share` of each dataset, at least one example. `datasets` are the examples of each.
    pub fn new(seed: u64, share: f64, datasets: &[Range<usize>]) -> Self {
        let mut split = Self { training: Vec::new(), validation: Vec::new() };
        for (stream, dataset) in (DIVISION..).zip(datasets) {
            let shuffled = shuffled(seed, stream, dataset.clone().collect());
            let held_out = ((dataset.len() as f64 * share).round() as usize).max(1).min(dataset.len());
            split.validation.extend_from_slice(&shuffled[..held_out]);
            split.training.push(shuffled[held_out..].to_vec());
        }
        split.validation.sort_unstable();
        split
    }

    /// All that is learned from, in ascending order.
    pub fn learned(&self) -> Vec<usize> {
        let mut learned = self.training.concat();
        learned.sort_unstable();
        learned
    }

    /// The examples of an epoch, numbered from 0, in their order: `counts` of each dataset. Epochs that take fewer than
    /// all take the ones after those of the epoch before, around and around, so that each comes up as often as the others.
    pub fn order(&self, seed: u64, epoch: usize, counts: &[usize]) -> Vec<usize> {
        let taken = self.training.iter().zip(counts).flat_map(|(examples, &count)| {
            let begin = (epoch * count) % examples.len().max(1);
            examples.iter().cycle().skip(begin).take(count).copied()
        });
        let mut taken: Vec<usize> = taken.collect();
        taken.sort_unstable();
        // Stream 0 belongs to the initial weights.
        shuffled(seed, epoch as u64 + 1, taken)
    }
}

fn shuffled(seed: u64, stream: u64, mut examples: Vec<usize>) -> Vec<usize> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(stream);
    examples.shuffle(&mut random);
    examples
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_dataset_gives_its_share_and_no_example_is_in_both() {
        let split = Split::new(3, 0.1, &[0..100, 100..140, 140..143]);
        let held_out = |range: Range<usize>| split.validation.iter().filter(|&i| range.contains(i)).count();
        assert_eq!([held_out(0..100), held_out(100..140), held_out(140..143)], [10, 4, 1]);
        let mut all = [split.learned(), split.validation.clone()].concat();
        all.sort_unstable();
        assert_eq!(all, (0..143).collect::<Vec<_>>());
    }

    #[test]
    fn the_seed_alone_decides() {
        let split = |seed| Split::new(seed, 0.1, &[0..100, 100..140]);
        assert_eq!(split(3), split(3));
        assert_ne!(split(3), split(4));
        assert_eq!(split(3).order(3, 5, &[90, 7]), split(3).order(3, 5, &[90, 7]));
    }

    #[test]
    fn each_epoch_is_another_permutation() {
        let split = Split::new(3, 0.1, &[0..60, 60..100]);
        let (mut first, second) = (split.order(3, 0, &[54, 36]), split.order(3, 1, &[54, 36]));
        assert_ne!(first, second);
        first.sort_unstable();
        assert_eq!(first, split.learned());
    }

    #[test]
    fn a_part_is_without_repetition_and_the_parts_go_through_all() {
        let split = Split::new(3, 0.1, &[0..60, 60..100]);
        let mut times = [0; 100];
        // 27 epochs of 20 are ten times the 54 training examples; 36 of the other are left out.
        for epoch in 0..27 {
            let order = split.order(3, epoch, &[20, 0]);
            let distinct: std::collections::BTreeSet<_> = order.iter().collect();
            assert_eq!((order.len(), distinct.len()), (20, 20));
            for example in order {
                times[example] += 1;
            }
        }
        for (example, times) in times.into_iter().enumerate() {
            assert_eq!(times, if split.training[0].contains(&example) { 10 } else { 0 });
        }
    }
}
