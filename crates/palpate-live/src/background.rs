//! Work that must not delay the mapper: thread pools of low priority.

use rayon::{ThreadPool, ThreadPoolBuilder};

/// Niceness of their threads.
const NICE: i32 = 10;

/// A thread pool of low priority; `None` if the system cannot start the threads.
pub(crate) fn nice_pool(name: &'static str) -> Option<ThreadPool> {
    // Affects the calling thread only; a failure is ignored.
    let nice = |_| {
        let _ = rustix::process::setpriority_process(None, NICE);
    };
    let name = move |number| format!("{name}-{number}");
    ThreadPoolBuilder::new().thread_name(name).start_handler(nice).build().ok()
}

/// Runs `work` on a pool; if there is none, on the calling thread with the common threads of rayon.
pub(crate) fn on<T: Send>(pool: Option<&ThreadPool>, work: impl FnOnce() -> T + Send) -> T {
    match pool {
        Some(pool) => pool.install(work),
        None => work(),
    }
}
