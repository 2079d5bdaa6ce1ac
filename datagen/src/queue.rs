//! Work that many threads do ahead of the one that takes its results, in order.

use std::sync::Mutex;
use std::sync::mpsc::sync_channel;

/// Results that may wait to be taken, beside those that each thread is at: enough to go on while a file is flushed to the disk.
const WAITING: usize = 24;

/// Results for each thread that may wait: one that takes long holds up the others only when they are so far ahead.
const WAITING_PER_THREAD: usize = 4;

/// Makes something of every item, with as many threads as the current rayon pool has, and hands it on in the order of the items.
///
/// The calling thread takes. When it takes no more, the others end after what they are at.
pub(crate) fn in_order<I: Send, T: Send, R>(
    items: impl Iterator<Item = I> + Send,
    make: impl Fn(I) -> T + Sync,
    take: impl FnOnce(&mut dyn Iterator<Item = T>) -> R,
) -> R {
    let threads = rayon::current_num_threads();
    // What is queued is the promise of a result. Whoever takes an item queues its promise before the next item is taken.
    let (promises, promised) = sync_channel(WAITING + WAITING_PER_THREAD * threads);
    let items = Mutex::new(Some((items, promises)));
    let next = || {
        let mut items = items.lock().ok()?;
        let (left, promises) = items.as_mut()?;
        let (keep, promise) = sync_channel(1);
        match left.next() {
            Some(item) if promises.send(promise).is_ok() => Some((item, keep)),
            // Without items, or no longer waited for.
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
                    // Fails if it is no longer waited for.
                    let _ = keep.send(make(item));
                }
            });
        }
        // A promise is broken only by a panic, which the scope passes on.
        take(&mut promised.into_iter().map_while(|promise| promise.recv().ok()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    fn pool(threads: usize) -> rayon::ThreadPool {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap()
    }

    #[test]
    fn results_come_in_order_whichever_takes_long() {
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
    fn the_threads_stay_within_bounds_and_end_when_nothing_more_is_taken() {
        let made = AtomicUsize::new(0);
        let count = |_| made.fetch_add(1, Ordering::Relaxed);
        let taken = pool(2).install(|| {
            in_order(0.., count, |results| {
                let first = results.next();
                std::thread::sleep(Duration::from_millis(50));
                first
            })
        });
        assert_eq!(taken, Some(0));
        let most = 1 + WAITING + 2 * WAITING_PER_THREAD + 2;
        assert!(
            (WAITING..=most).contains(&made.load(Ordering::Relaxed)),
            "{made:?} were made, at most {most}"
        );
    }
}
