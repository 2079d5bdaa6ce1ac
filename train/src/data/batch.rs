//! The images of a step, loaded in the background. Floating point is f32 from here on.

use std::borrow::Cow;
use std::sync::mpsc;
use std::thread;

use burn::tensor::Device;

use super::examples::Examples;
use super::input;
use crate::error::Result;
use crate::network::images::Images;

/// Examples with their pixels.
pub(crate) struct Batch<'a> {
    /// Indices of the examples.
    pub(crate) indices: &'a [usize],
    /// Pixels of each example: those of its images, one after the other.
    pixels: Vec<Cow<'a, [u8]>>,
    input: [usize; 2],
}

impl<'a> Batch<'a> {
    /// Loads the pixels of examples.
    pub(crate) fn load(examples: &'a Examples, indices: &'a [usize]) -> Result<Self> {
        Ok(Self { indices, pixels: examples.pixels(indices)?, input: examples.input() })
    }

    /// Returns the images as tensors.
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

/// Loads batches in the background, one ahead of the batch in use, and passes them to `consume`.
///
/// Loading waits for threads of rayon's pool, so do not call this from one of them.
pub(crate) fn prefetch<'a, R>(
    examples: &'a Examples,
    batches: impl Iterator<Item = &'a [usize]> + Send,
    consume: impl FnOnce(&mut dyn Iterator<Item = Result<Batch<'a>>>) -> R,
) -> R {
    thread::scope(|scope| {
        let (loaded, next) = mpsc::sync_channel(0);
        scope.spawn(move || {
            for indices in batches {
                if loaded.send(Batch::load(examples, indices)).is_err() {
                    // The consumer has stopped.
                    break;
                }
            }
        });
        let mut next = next.into_iter();
        consume(&mut next)
    })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::{Duration, Instant};

    use datagen::Kind;

    use super::*;
    use crate::config::tests::tiny;
    use crate::data::examples::tests::squares;

    #[test]
    fn batches_arrive_in_order_one_ahead() {
        let examples = squares(&tiny(Kind::Approach).task().unwrap(), 10);
        let indices: Vec<_> = (0..10).collect();
        let begun = AtomicUsize::new(0);
        let count = |_: &&[usize]| {
            begun.fetch_add(1, Ordering::Relaxed);
        };
        let batches = || indices.chunks(3).inspect(count);
        let taken: Vec<_> = prefetch(&examples, batches(), |batches| {
            batches.map(|batch| batch.unwrap().indices.to_vec()).collect()
        });
        assert_eq!(taken, [vec![0, 1, 2], vec![3, 4, 5], vec![6, 7, 8], vec![9]]);
        // A consumer that stops after the first batch has caused the second one to be loaded, and no more.
        begun.store(0, Ordering::Relaxed);
        prefetch(&examples, batches(), |batches| {
            batches.next().unwrap().unwrap();
            let deadline = Instant::now() + Duration::from_mins(1);
            while begun.load(Ordering::Relaxed) < 2 && Instant::now() < deadline {
                thread::yield_now();
            }
            // The third batch must not be loaded while the second waits to be taken.
            thread::sleep(Duration::from_millis(5));
        });
        assert_eq!(begun.into_inner(), 2);
    }
}
