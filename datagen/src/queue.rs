//! An ordered parallel map: threads compute ahead of the caller, which consumes the results in order.

use std::sync::Mutex;
use std::sync::mpsc::sync_channel;

/// Finished results that may wait for the caller, enough to keep the threads busy while a file is flushed to the disk.
const WAITING: usize = 24;

/// Further waiting results per thread, so that one slow item does not stall the others immediately.
const WAITING_PER_THREAD: usize = 4;

/// Maps items with as many threads as the current rayon pool has, and passes the results to `take` in the order of the items.
///
/// `take` runs on the calling thread. After it returns, the other threads finish their current item and end.
pub(crate) fn in_order<I: Send, T: Send, R>(
    items: impl Iterator<Item = I> + Send,
    make: impl Fn(I) -> T + Sync,
    take: impl FnOnce(&mut dyn Iterator<Item = T>) -> R,
) -> R {
    let threads = rayon::current_num_threads();
    // The queue holds promises of results. A thread that takes an item queues its promise before the next item is taken,
    // so the promises are in the order of the items.
    let (promises, promised) = sync_channel(WAITING + WAITING_PER_THREAD * threads);
    let items = Mutex::new(Some((items, promises)));
    let next = || {
        let mut items = items.lock().ok()?;
        let (left, promises) = items.as_mut()?;
        let (keep, promise) = sync_channel(1);
        match left.next() {
            Some(item) if promises.send(promise).is_ok() => Some((item, keep)),
            // There are no more items, or the caller has stopped.
            _ => {
                *items = None;
                None
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                while let Some((item, keep)) = next() {
                    // Fails if the caller has stopped.
                    let _ = keep.send(make(item));
                }
            });
        }
        // A promise is broken only by a panic, which the scope propagates.
        take(&mut promised.into_iter().map_while(|promise| promise.recv().ok()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::{Duration, Instant};

    fn pool(threads: usize) -> rayon::ThreadPool {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
    }

    #[test]
    fn results_come_in_order_whatever_their_duration() {
        let slow = |i: u64| {
            std::thread::sleep(Duration::from_micros(if i.is_multiple_of(7) { 2000 } else { 10 }));
            i * i
        };
        for threads in [1, 3] {
            let squares =
                pool(threads).install(|| in_order(0..200, slow, |results| results.collect::<Vec<_>>()));
            assert_eq!(squares, (0..200).map(|i| i * i).collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_threads_compute_a_bounded_number_ahead_and_end_with_the_caller() {
        let made = AtomicUsize::new(0);
        let count = |_| made.fetch_add(1, Ordering::Relaxed);
        let taken = pool(2).install(|| {
            in_order(0.., count, |results| {
                let first = results.next();
                // A slow machine needs longer; without the threads nothing would ever come.
                let deadline = Instant::now() + Duration::from_mins(1);
                while made.load(Ordering::Relaxed) < WAITING && Instant::now() < deadline {
                    std::thread::yield_now();
                }
                first
            })
        });
        assert_eq!(taken, Some(0));
        let most = 1 + WAITING + 2 * WAITING_PER_THREAD + 2;
        assert!(
            (WAITING..=most).contains(&made.load(Ordering::Relaxed)),
            "{made:?} computed, expected at most {most}"
        );
    }
}
