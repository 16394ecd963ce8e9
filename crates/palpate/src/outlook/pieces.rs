//! Work in pieces, for as many threads as have time for it.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};

/// Pieces that wait for whoever is free.
struct Job<W> {
    pieces: usize,
    /// The next that nobody has begun.
    next: AtomicUsize,
    work: W,
}

impl<T, W: Fn(usize) -> T> Job<W> {
    /// Works out pieces until all have been begun.
    fn help(&self, done: &Sender<(usize, T)>) {
        loop {
            let piece = self.next.fetch_add(1, Ordering::Relaxed);
            // Whoever asked may have panicked meanwhile, and listens no more.
            if piece >= self.pieces || done.send((piece, (self.work)(piece))).is_err() {
                return;
            }
        }
    }
}

/// The results of all pieces in their order, from this thread and rayon's.
///
/// A thread of rayon's that gets no core in time is not waited for: whoever asks begins at once, and
/// the other finds nothing left to do.
pub(super) fn in_pieces<T: Send + 'static>(
    pieces: usize,
    work: impl Fn(usize) -> T + Send + Sync + 'static,
) -> Vec<T> {
    let job = Arc::new(Job { pieces, next: AtomicUsize::new(0), work });
    let (done, results) = channel();
    for _ in 1..rayon::current_num_threads().min(pieces) {
        let (job, done) = (Arc::clone(&job), done.clone());
        rayon::spawn(move || job.help(&done));
    }
    job.help(&done);
    drop(done);
    let mut results: Vec<(usize, T)> = results.iter().take(pieces).collect();
    results.sort_unstable_by_key(|(piece, _)| *piece);
    results.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_piece_is_worked_out_once_and_comes_in_its_place() {
        for pieces in [0, 1, 2, 7, 100] {
            let work = |piece| (piece, std::thread::current().id());
            let results = in_pieces(pieces, work);
            let order: Vec<usize> = results.iter().map(|(piece, _)| *piece).collect();
            assert_eq!(order, (0..pieces).collect::<Vec<_>>());
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
