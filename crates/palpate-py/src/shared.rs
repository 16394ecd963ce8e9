//! An object that several Python threads use one at a time.

use std::cell::RefCell;
use std::thread;
use std::time::Duration;

use parking_lot::{ReentrantMutex, ReentrantMutexGuard};
use pyo3::prelude::*;

use crate::error::PalpateError;

/// An object that one thread at a time can use; the others wait, and Ctrl-C ends their waiting.
///
/// After a panic it can still be used.
pub(crate) struct Shared<T>(ReentrantMutex<RefCell<T>>);

impl<T> Shared<T> {
    pub(crate) fn new(inner: T) -> Self {
        Self(ReentrantMutex::new(RefCell::new(inner)))
    }

    /// Locks the object; waits while another thread uses it.
    ///
    /// # Errors
    ///
    /// On Ctrl-C, or if the same thread already uses it, in a progress callback.
    pub(crate) fn take(&self, py: Python<'_>) -> PyResult<ReentrantMutexGuard<'_, RefCell<T>>> {
        if self.0.is_owned_by_current_thread() {
            return Err(PalpateError::new_err(
                "the mapper is busy, and a `progress` callback cannot use it; take a snapshot before, \
                 or map touch by touch",
            ));
        }
        loop {
            if let Some(inner) = self.0.try_lock() {
                return Ok(inner);
            }
            py.detach(|| thread::sleep(Duration::from_millis(1)));
            py.check_signals()?;
        }
    }
}
