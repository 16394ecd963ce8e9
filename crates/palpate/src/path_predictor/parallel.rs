//! Work in chunks, shared by all free threads.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread;

/// Chunks that wait for a free thread.
struct Job<W> {
    chunks: usize,
    /// The next chunk that no thread has begun.
    next: AtomicUsize,
    work: W,
}

impl<T, W: Fn(usize) -> T> Job<W> {
    /// Processes chunks until all have been begun.
    fn help(&self, done: &Sender<(usize, thread::Result<T>)>) {
        loop {
            let chunk = self.next.fetch_add(1, Ordering::Relaxed);
            if chunk >= self.chunks {
                return;
            }
            let result = catch_unwind(AssertUnwindSafe(|| (self.work)(chunk)));
            let _ = done.send((chunk, result)); // the caller waits for every chunk
        }
    }
}

/// The results of all chunks in their order, from this thread and rayon's.
///
/// The caller begins at once and does not wait for a thread of the pool that gets no core in time: that
/// thread finds nothing left to do.
///
/// # Panics
///
/// With the panic of a chunk.
pub(super) fn in_chunks<T: Send + 'static>(
    chunks: usize,
    work: impl Fn(usize) -> T + Send + Sync + 'static,
) -> Vec<T> {
    let job = Arc::new(Job { chunks, next: AtomicUsize::new(0), work });
    let (done, results) = channel();
    for _ in 1..rayon::current_num_threads().min(chunks) {
        let (job, done) = (Arc::downgrade(&job), done.clone());
        rayon::spawn(move || {
            if let Some(job) = job.upgrade() {
                job.help(&done);
            }
        });
    }
    job.help(&done);
    drop(done);
    let mut results: Vec<(usize, thread::Result<T>)> = results.iter().take(chunks).collect();
    results.sort_unstable_by_key(|(chunk, _)| *chunk);
    let result =
        |(_, result): (usize, thread::Result<T>)| result.unwrap_or_else(|e| resume_unwind(e));
    results.into_iter().map(result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_chunk_is_worked_out_once_and_comes_in_its_place() {
        for chunks in [0, 1, 2, 7, 100] {
            let calls = Arc::new(AtomicUsize::new(0));
            let counted = Arc::clone(&calls);
            let results = in_chunks(chunks, move |chunk| {
                counted.fetch_add(1, Ordering::Relaxed);
                chunk * chunk
            });
            assert_eq!(results, (0..chunks).map(|chunk| chunk * chunk).collect::<Vec<_>>());
            assert_eq!(calls.load(Ordering::Relaxed), chunks);
        }
    }

    #[test]
    fn a_panic_reaches_the_caller_whichever_thread_it_is_on() {
        for bad in [0, 3, 15] {
            let work = move |chunk| assert!(chunk != bad, "chunk {chunk}");
            let panic = catch_unwind(|| in_chunks(16, work)).unwrap_err();
            assert_eq!(*panic.downcast::<String>().unwrap(), format!("chunk {bad}"));
        }
    }

    #[test]
    fn an_answer_does_not_wait_for_busy_threads() {
        let (let_go, held) = channel::<()>();
        let held = std::sync::Mutex::new(held);
        let held = Arc::new(held);
        for _ in 0..rayon::current_num_threads() {
            let held = Arc::clone(&held);
            rayon::spawn(move || drop(held.lock().map(|held| held.recv())));
        }
        assert_eq!(in_chunks(5, |chunk| chunk), [0, 1, 2, 3, 4]);
        drop(let_go);
    }
}
