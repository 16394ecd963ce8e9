//! Work that must not delay the mapper: thread pools of low priority.

use rayon::{ThreadPool, ThreadPoolBuilder};

/// How much of the machine a pool may use.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Share {
    /// All cores, if the mapper leaves time: for work that must keep up with the arm.
    All,
    /// Half of the cores, as far as no other thread wants them: for work that can wait.
    Half,
}

/// A thread pool of low priority; `None` if the system cannot start the threads.
pub(crate) fn nice_pool(name: &'static str, share: Share) -> Option<ThreadPool> {
    let (niceness, threads) = match share {
        Share::All => (10, 0), // the default of rayon
        Share::Half => {
            let cores = std::thread::available_parallelism().map_or(1, |cores| cores.get());
            (19, (cores / 2).max(1))
        }
    };
    // Affects the calling thread only; a failure is ignored.
    let nice = move |_| {
        let _ = rustix::process::setpriority_process(None, niceness);
    };
    let name = move |number| format!("{name}-{number}");
    let pool = ThreadPoolBuilder::new().thread_name(name).num_threads(threads);
    pool.start_handler(nice).build().ok()
}

/// Runs `work` on a pool; if there is none, on the calling thread with the common threads of rayon.
pub(crate) fn on<T: Send>(pool: Option<&ThreadPool>, work: impl FnOnce() -> T + Send) -> T {
    match pool {
        Some(pool) => pool.install(work),
        None => work(),
    }
}
