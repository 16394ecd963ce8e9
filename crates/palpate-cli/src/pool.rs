//! Runs a loop on a worker of the thread pool, so that the mapper's joins need no hand-over.
//!
//! `Mapper::step` does two things at once with `rayon::join`. Called from outside the pool, as
//! from `main`, every join hands its work to a worker and sleeps until that is done: two context
//! switches a step, which small steps feel. So the loop as a whole moves to a worker, once.
//!
//! The caller sleeps meanwhile. What the loop gives comes back to it, and so does a panic, of which
//! the hook of `main` has told by then.

/// Runs `work` on a worker of the global pool and waits for it; at once if this is a worker.
pub(crate) fn on_a_worker<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::scope(|_| work())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_runs_on_one_worker_however_deep_and_its_result_comes_back() {
        assert_eq!(rayon::current_thread_index(), None);
        let (outer, inner) = on_a_worker(|| {
            (rayon::current_thread_index(), on_a_worker(rayon::current_thread_index))
        });
        assert!(outer.is_some() && inner == outer, "{outer:?}, {inner:?}");
    }

    #[test]
    fn a_panic_reaches_the_caller_with_what_it_said() {
        let panic = std::panic::catch_unwind(|| on_a_worker(|| panic!("a defect"))).unwrap_err();
        assert_eq!(panic.downcast_ref(), Some(&"a defect"));
    }
}
