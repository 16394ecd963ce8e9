//! What several Python threads may use, one at a time.

use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};
use std::thread::{self, ThreadId};
use std::time::Duration;

use pyo3::prelude::*;

use crate::error::PalpateError;

/// Something that is used by one thread at a time; the others wait, and Ctrl-C ends their waiting.
pub(crate) struct Shared<T> {
    inner: Mutex<T>,
    /// Who uses it.
    user: Mutex<Option<ThreadId>>,
}

/// The use of something; over when this is dropped.
pub(crate) struct InUse<'a, T> {
    pub(crate) inner: MutexGuard<'a, T>,
    user: &'a Mutex<Option<ThreadId>>,
}

impl<T> Drop for InUse<'_, T> {
    fn drop(&mut self) {
        *self.user.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

impl<T> Shared<T> {
    pub(crate) fn new(inner: T) -> Self {
        Self { inner: Mutex::new(inner), user: Mutex::new(None) }
    }

    /// Waits until nobody else uses it.
    ///
    /// # Errors
    ///
    /// On Ctrl-C, or if this very thread uses it already: from within its own progress.
    pub(crate) fn take(&self, py: Python<'_>) -> PyResult<InUse<'_, T>> {
        let user = || self.user.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            let inner = match self.inner.try_lock() {
                Ok(inner) => inner,
                // A panic is told as such; what it left behind is as it was before the step.
                Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
                Err(TryLockError::WouldBlock) => {
                    if *user() == Some(thread::current().id()) {
                        return Err(PalpateError::new_err(
                            "the mapper is at work, and cannot be asked from within its own \
                             progress; take a snapshot before, or map touch by touch",
                        ));
                    }
                    py.detach(|| thread::sleep(Duration::from_millis(1)));
                    py.check_signals()?;
                    continue;
                }
            };
            *user() = Some(thread::current().id());
            return Ok(InUse { inner, user: &self.user });
        }
    }
}
