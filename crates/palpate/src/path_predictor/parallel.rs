//! Work in pieces, for as many threads as have time for it.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread;

/// Pieces that wait for whoever is free.
struct Job<W> {
    pieces: usize,
    /// The next that nobody has begun.
    next: AtomicUsize,
    work: W,
}

impl<T, W: Fn(usize) -> T> Job<W> {
    /// Works out pieces until all have been begun.
    fn help(&self, done: &Sender<(usize, thread::Result<T>)>) {
        loop {
            let piece = self.next.fetch_add(1, Ordering::Relaxed);
            if piece >= self.pieces {
                return;
            }
            let result = catch_unwind(AssertUnwindSafe(|| (self.work)(piece)));
            if done.send((piece, result)).is_err() {
                return; // whoever asked has heard of a panic, and listens no more
            }
        }
    }
}

/// The results of all pieces in their order, from this thread and rayon's.
///
/// A thread of rayon's that gets no core in time is not waited for: whoever asks begins at once,
/// and the other finds nothing left to do.
///
/// # Panics
///
/// With whatever a piece panics with.
pub(super) fn in_pieces<T: Send + 'static>(
    pieces: usize,
    work: impl Fn(usize) -> T + Send + Sync + 'static,
) -> Vec<T> {
    let job = Arc::new(Job { pieces, next: AtomicUsize::new(0), work });
    let (done, results) = channel();
    for _ in 1..rayon::current_num_threads().min(pieces) {
        let (job, done) = (Arc::downgrade(&job), done.clone());
        rayon::spawn(move || {
            if let Some(job) = job.upgrade() {
                job.help(&done);
            }
        });
    }
    job.help(&done);
    drop(done);
    let mut results: Vec<(usize, thread::Result<T>)> = results.iter().take(pieces).collect();
    results.sort_unstable_by_key(|(piece, _)| *piece);
    let result =
        |(_, result): (usize, thread::Result<T>)| result.unwrap_or_else(|e| resume_unwind(e));
    results.into_iter().map(result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_piece_is_worked_out_once_and_comes_in_its_place() {
        for pieces in [0, 1, 2, 7, 100] {
            let calls = Arc::new(AtomicUsize::new(0));
            let counted = Arc::clone(&calls);
            let results = in_pieces(pieces, move |piece| {
                counted.fetch_add(1, Ordering::Relaxed);
                piece * piece
            });
            assert_eq!(results, (0..pieces).map(|piece| piece * piece).collect::<Vec<_>>());
            assert_eq!(calls.load(Ordering::Relaxed), pieces);
        }
    }

    #[test]
    fn a_panic_reaches_whoever_asks_whichever_thread_it_is_on() {
        for bad in [0, 3, 15] {
            let work = move |piece| assert!(piece != bad, "piece {piece}");
            let panic = catch_unwind(|| in_pieces(16, work)).unwrap_err();
            assert_eq!(*panic.downcast::<String>().unwrap(), format!("piece {bad}"));
        }
    }

    #[test]
    fn threads_that_have_no_time_are_not_waited_for() {
        let (let_go, held) = channel::<()>();
        let held = std::sync::Mutex::new(held);
        let held = Arc::new(held);
        for _ in 0..rayon::current_num_threads() {
            let held = Arc::clone(&held);
            rayon::spawn(move || drop(held.lock().map(|held| held.recv())));
        }
        assert_eq!(in_pieces(5, |piece| piece), [0, 1, 2, 3, 4]);
        drop(let_go);
    }
}
