//! Training and validation sets, and the order of the examples in each epoch: pure functions of the seed.

use std::ops::Range;

use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// First random stream for splitting datasets. Smaller ones belong to epochs.
const DIVISION: u64 = 1 << 32;

/// Indices of the training and validation examples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Split {
    /// Training examples of each dataset, in a fixed random order.
    pub training: Vec<Vec<usize>>,
    /// Validation examples of all datasets, in ascending order.
    pub validation: Vec<usize>,
}

impl Split {
    /// Holds out the same `share` of each dataset, and at least one example. `datasets` are their ranges of indices.
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

    /// Returns all training examples in ascending order.
    pub fn all_training(&self) -> Vec<usize> {
        let mut all = self.training.concat();
        all.sort_unstable();
        all
    }

    /// Returns the examples of an epoch in order, `counts` of each dataset. Epochs are numbered from 0.
    ///
    /// An epoch that takes only a part of a dataset continues where the previous one ended, cyclically, so that all examples
    /// are used equally often.
    pub fn order(&self, seed: u64, epoch: usize, counts: &[usize]) -> Vec<usize> {
        let taken = self.training.iter().zip(counts).flat_map(|(examples, &count)| {
            let begin = (epoch * count) % examples.len().max(1);
            examples.iter().cycle().skip(begin).take(count).copied()
        });
        let mut taken: Vec<usize> = taken.collect();
        taken.sort_unstable();
        // Stream 0 is used for the initial weights.
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
        let mut all = [split.all_training(), split.validation.clone()].concat();
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
        assert_eq!(first, split.all_training());
    }

    #[test]
    fn partial_epochs_do_not_repeat_and_cover_everything() {
        let split = Split::new(3, 0.1, &[0..60, 60..100]);
        let mut times = [0; 100];
        // 27 epochs of 20 are ten times the 54 training examples. The other dataset is omitted.
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
