//! The examples of a step, and what the networks see of them; f32 begins here.

use std::borrow::Cow;
use std::sync::mpsc;
use std::thread;

use burn::tensor::{Device, Tensor};

use crate::error::Result;
use crate::examples::Examples;
use crate::input;

/// Some examples with their pixels.
pub(crate) struct Batch<'a> {
    /// Numbers of the examples.
    pub(crate) indices: &'a [usize],
    /// Of each example, those of all its images one after the other.
    pixels: Vec<Cow<'a, [u8]>>,
    input: [usize; 2],
}

/// What the networks see of a batch: `[batch, height, width, 3]` each, from -1 to 1.
#[derive(Debug, Clone)]
pub struct Images {
    /// The current images.
    pub current: Tensor<4>,
    /// The goal images, for `CNN_approach` alone.
    pub goal: Option<Tensor<4>>,
}

impl<'a> Batch<'a> {
    pub(crate) fn new(examples: &'a Examples, indices: &'a [usize]) -> Result<Self> {
        Ok(Self { indices, pixels: examples.pixels(indices)?, input: examples.input() })
    }

    /// What the networks see.
    pub(crate) fn images(&self, device: &Device) -> Images {
        let bytes = input::bytes(self.input);
        let images = |which| {
            let within = which * bytes..(which + 1) * bytes;
            let images: Vec<_> = self.pixels.iter().map(|pixels| &pixels[within.clone()]).collect();
            input::tensor(&images, self.input, device)
        };
        let pairs = self.pixels.first().is_some_and(|pixels| pixels.len() > bytes);
        Images { current: images(0), goal: pairs.then(|| images(1)) }
    }
}

/// Takes one batch after the other; the next is read and decoded while one is in use, and no further one.
///
/// Reading waits for threads of rayon's pool, so none of them should be the one that calls this.
pub(crate) fn ahead<'a, R>(
    examples: &'a Examples,
    batches: impl Iterator<Item = &'a [usize]> + Send,
    take: impl FnOnce(&mut dyn Iterator<Item = Result<Batch<'a>>>) -> R,
) -> R {
    thread::scope(|scope| {
        let (made, next) = mpsc::sync_channel(0);
        scope.spawn(move || {
            for indices in batches {
                if made.send(Batch::new(examples, indices)).is_err() {
                    // Nobody takes it any more.
                    break;
                }
            }
        });
        let mut next = next.into_iter();
        take(&mut next)
    })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    use datagen::Kind;

    use super::*;
    use crate::config::tests::tiny;
    use crate::examples::tests::squares;

    #[test]
    fn batches_come_in_order_one_ahead() {
        let examples = squares(&tiny(Kind::Approach).task().unwrap(), 10);
        let indices: Vec<_> = (0..10).collect();
        let begun = AtomicUsize::new(0);
        let count = |_: &&[usize]| {
            begun.fetch_add(1, Ordering::Relaxed);
        };
        let batches = || indices.chunks(3).inspect(count);
        let taken: Vec<_> = ahead(&examples, batches(), |batches| {
            batches.map(|batch| batch.unwrap().indices.to_vec()).collect()
        });
        assert_eq!(taken, [vec![0, 1, 2], vec![3, 4, 5], vec![6, 7, 8], vec![9]]);
        // Whoever stops after the first batch finds the second one made, and no more.
        begun.store(0, Ordering::Relaxed);
        ahead(&examples, batches(), |batches| {
            batches.next().unwrap().unwrap();
            while begun.load(Ordering::Relaxed) < 2 {
                thread::yield_now();
            }
            thread::sleep(Duration::from_millis(5));
        });
        assert_eq!(begun.into_inner(), 2);
    }
}
