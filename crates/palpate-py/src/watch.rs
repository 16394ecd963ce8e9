//! Runs long work on a separate thread, while the calling thread watches it.
//!
//! The work does not use Python and does not hold the GIL. The calling thread checks every [`LOOK`]:
//! it shows the progress, and on Ctrl-C stops the work at its next step. Notes and warnings of the
//! work are reported at its end.

use std::ffi::CString;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use palpate_work::{Bar, Progress};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyBool;

use crate::error::{PalpateWarning, Raised, Result, in_keywords};

/// Interval at which the calling thread checks the work.
const LOOK: Duration = Duration::from_millis(50);

/// A stage of the work, and its progress.
struct Stretch {
    steps: Option<u64>,
    doing: String,
    done: AtomicU64,
}

/// The progress of long work.
#[derive(Default)]
pub(crate) struct Watch {
    stop: AtomicBool,
    /// The present stage; replaced when a new one begins.
    stretch: Mutex<Option<Arc<Stretch>>>,
    messages: Mutex<Vec<Message>>,
}

/// A message for the user.
#[derive(Clone)]
pub(crate) enum Message {
    Note(String),
    Warning(String),
}

struct Steps(Arc<Stretch>);

impl Bar for Steps {
    fn step(&self) {
        self.0.done.fetch_add(1, Ordering::Relaxed);
    }

    fn at(&self, _: &str) {}
}

impl Progress for Watch {
    fn note(&self, text: &str) {
        self.push(Message::Note(text.to_owned()));
    }

    fn warn(&self, text: &str) {
        self.push(Message::Warning(text.to_owned()));
    }

    fn begin(&self, steps: Option<u64>, _: &'static str, doing: &str) -> Box<dyn Bar> {
        let stretch = Stretch { steps, doing: doing.to_owned(), done: AtomicU64::new(0) };
        let stretch = Arc::new(stretch);
        *self.stretch.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::clone(&stretch));
        Box::new(Steps(stretch))
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

impl Watch {
    /// The messages so far.
    pub(crate) fn messages(&self) -> Vec<Message> {
        self.messages.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Adds a message, which is reported when the work has ended.
    pub(crate) fn push(&self, message: Message) {
        self.messages.lock().unwrap_or_else(PoisonError::into_inner).push(message);
    }

    /// Reports the messages: notes to the logger `palpate`, warnings as Python warnings.
    pub(crate) fn say(&self, py: Python<'_>) -> PyResult<()> {
        let messages =
            std::mem::take(&mut *self.messages.lock().unwrap_or_else(PoisonError::into_inner));
        for message in messages {
            match message {
                Message::Note(text) => {
                    let logging = py.import(intern!(py, "logging"))?;
                    let logger = logging.call_method1(intern!(py, "getLogger"), ("palpate",))?;
                    logger.call_method1(intern!(py, "info"), ("%s", in_keywords(&text)))?;
                }
                Message::Warning(text) => {
                    let category = py.get_type::<PalpateWarning>();
                    let text =
                        CString::new(in_keywords(&text).replace('\0', " ")).unwrap_or_default();
                    PyErr::warn(py, &category, &text, 1)?;
                }
            }
        }
        Ok(())
    }
}

/// Shows the progress of the work in Python.
struct Shown<'py> {
    progress: Bound<'py, PyAny>,
    /// The last stage and number of steps shown.
    last: Option<(Arc<Stretch>, u64)>,
}

impl Shown<'_> {
    fn show(&mut self, watch: &Watch) -> PyResult<()> {
        let stretch = watch.stretch.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let Some(stretch) = stretch else { return Ok(()) };
        let done = stretch.done.load(Ordering::Relaxed);
        let is_same = |last: &(Arc<Stretch>, u64)| Arc::ptr_eq(&last.0, &stretch) && last.1 == done;
        if !self.last.as_ref().is_some_and(is_same) {
            self.progress.call1((done, stretch.steps, &stretch.doing))?;
            self.last = Some((stretch, done));
        }
        Ok(())
    }
}

/// Runs long work with the GIL released; Ctrl-C stops it, and `progress` is shown.
///
/// `progress` is `None` for a bar if a terminal or notebook shows it, a bool, or a callable that gets
/// the numbers of steps done and in total.
///
/// # Errors
///
/// The error of the work; or `KeyboardInterrupt`, or the exception of `progress`, after which the work
/// is stopped.
pub(crate) fn long<T: Send, E: Into<Raised> + Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Watch) -> Result<T, E> + Send,
) -> Result<T> {
    let module = py.import(intern!(py, "palpate._progress"))?;
    let progress = module.call_method1(intern!(py, "of"), (progress,))?;
    let mut shown = Shown { progress, last: None };
    let watch = Watch::default();
    let done = watched(py, &mut shown, &watch, work);
    shown.progress.call_method0(intern!(py, "close"))?;
    let done = done?;
    watch.say(py)?;
    done.map_err(Into::into)
}

/// Runs long work without showing progress.
pub(crate) fn unshown<T: Send, E: Into<Raised> + Send>(
    py: Python<'_>,
    work: impl FnOnce(&Watch) -> Result<T, E> + Send,
) -> Result<T> {
    long(py, Some(PyBool::new(py, false).as_any()), work)
}

fn watched<T: Send>(
    py: Python<'_>,
    shown: &mut Shown<'_>,
    watch: &Watch,
    work: impl FnOnce(&Watch) -> T + Send,
) -> PyResult<T> {
    let (asker, is_over) = (thread::current(), AtomicBool::new(false));
    thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let done = work(watch);
            is_over.store(true, Ordering::Release);
            asker.unpark();
            done
        });
        let mut failed = None;
        // A worker that panics does not set `is_over`.
        while !is_over.load(Ordering::Acquire) && !worker.is_finished() {
            py.detach(|| thread::park_timeout(LOOK));
            if failed.is_some() {
                continue; // the work stops at its next step
            }
            if let Err(error) = py.check_signals().and_then(|()| shown.show(watch)) {
                watch.stop.store(true, Ordering::Relaxed);
                failed = Some(error);
            }
        }
        let done = py.detach(|| worker.join());
        let done = done.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        match failed {
            Some(error) => Err(error),
            None => shown.show(watch).map(|()| done),
        }
    })
}
