//! Long work on a thread of its own, watched by the one that asked for it.
//!
//! The work knows no Python and holds no lock of it. Whoever asked looks in on it every
//! [`LOOK`]: shows how far it is, and stops it at its next step on Ctrl-C. What it has to tell is
//! told when it is over.

use std::ffi::CString;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use palpate_work::{Bar, Progress};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyBool;

use crate::error::{PalpateWarning, Raised, Result};

/// How often the work is looked in on.
const LOOK: Duration = Duration::from_millis(50);

/// How far the work is.
#[derive(Default)]
struct Far {
    /// What it is doing; changes when a new stretch begins.
    stretch: Mutex<Option<Stretch>>,
    done: AtomicU64,
}

#[derive(Clone, Default)]
struct Stretch {
    number: u64,
    steps: Option<u64>,
    doing: String,
}

/// The progress of long work.
#[derive(Default)]
pub(crate) struct Watch {
    stop: AtomicBool,
    far: Arc<Far>,
    told: Mutex<Vec<Told>>,
}

enum Told {
    Note(String),
    Warning(String),
}

struct Steps(Arc<Far>);

impl Bar for Steps {
    fn step(&self) {
        self.0.done.fetch_add(1, Ordering::Relaxed);
    }

    fn at(&self, _: &str) {}
}

impl Progress for Watch {
    fn note(&self, text: &str) {
        self.tell(Told::Note(text.to_owned()));
    }

    fn warn(&self, text: &str) {
        self.tell(Told::Warning(text.to_owned()));
    }

    fn begin(&self, steps: Option<u64>, _: &'static str, doing: &str) -> Box<dyn Bar> {
        let mut stretch = self.far.stretch.lock().unwrap_or_else(PoisonError::into_inner);
        let number = stretch.as_ref().map_or(0, |stretch| stretch.number + 1);
        *stretch = Some(Stretch { number, steps, doing: doing.to_owned() });
        self.far.done.store(0, Ordering::Relaxed);
        Box::new(Steps(Arc::clone(&self.far)))
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

impl Watch {
    fn tell(&self, told: Told) {
        self.told.lock().unwrap_or_else(PoisonError::into_inner).push(told);
    }

    /// Says what there is to say: notes to the logger `palpate`, oddities as warnings.
    pub(crate) fn say(&self, py: Python<'_>) -> PyResult<()> {
        let told = std::mem::take(&mut *self.told.lock().unwrap_or_else(PoisonError::into_inner));
        for told in told {
            match told {
                Told::Note(text) => {
                    let logging = py.import(intern!(py, "logging"))?;
                    let logger = logging.call_method1(intern!(py, "getLogger"), ("palpate",))?;
                    logger.call_method1(intern!(py, "info"), ("%s", text))?;
                }
                Told::Warning(text) => {
                    let category = py.get_type::<PalpateWarning>();
                    let text = CString::new(text.replace('\0', " ")).unwrap_or_default();
                    PyErr::warn(py, &category, &text, 1)?;
                }
            }
        }
        Ok(())
    }
}

/// What Python is shown of how far the work is.
struct Shown<'py> {
    progress: Bound<'py, PyAny>,
    told: (u64, u64),
}

impl Shown<'_> {
    fn show(&mut self, far: &Far) -> PyResult<()> {
        let stretch = far.stretch.lock().unwrap_or_else(PoisonError::into_inner).clone();
        let Some(Stretch { number, steps, doing }) = stretch else { return Ok(()) };
        let done = far.done.load(Ordering::Relaxed);
        if self.told != (number, done) {
            self.told = (number, done);
            self.progress.call1((done, steps, doing))?;
        }
        Ok(())
    }
}

/// Does long work with the GIL released; Ctrl-C stops it, `progress` is shown how far it is.
///
/// `progress` is `None` for where it makes sense, a truth value, or something to call with steps
/// done and steps in all.
///
/// # Errors
///
/// What the work says, `KeyboardInterrupt`, or what `progress` raised: the work was stopped then.
pub(crate) fn long<T: Send, E: Into<Raised> + Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Watch) -> Result<T, E> + Send,
) -> Result<T> {
    let module = py.import(intern!(py, "palpate._progress"))?;
    let progress = module.call_method1(intern!(py, "of"), (progress,))?;
    let shown = if progress.is_none() {
        None
    } else {
        Some(Shown { progress: progress.clone(), told: (u64::MAX, 0) })
    };
    let watch = Watch::default();
    let done = watched(py, shown, &watch, work);
    if !progress.is_none() {
        progress.call_method0(intern!(py, "close"))?;
    }
    let done = done?;
    watch.say(py)?;
    done.map_err(Into::into)
}

/// Does long work that has no steps to show.
pub(crate) fn unshown<T: Send, E: Into<Raised> + Send>(
    py: Python<'_>,
    work: impl FnOnce(&Watch) -> Result<T, E> + Send,
) -> Result<T> {
    long(py, Some(PyBool::new(py, false).as_any()), work)
}

/// Wakes whoever asked when the work is over, or has failed.
struct Over {
    asker: thread::Thread,
    is_over: Arc<AtomicBool>,
}

impl Drop for Over {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Release);
        self.asker.unpark();
    }
}

fn watched<T: Send>(
    py: Python<'_>,
    mut shown: Option<Shown<'_>>,
    watch: &Watch,
    work: impl FnOnce(&Watch) -> T + Send,
) -> PyResult<T> {
    thread::scope(|scope| {
        let over = Over { asker: thread::current(), is_over: Arc::default() };
        let is_over = Arc::clone(&over.is_over);
        let worker = scope.spawn(move || {
            let _over = over;
            work(watch)
        });
        let mut failed = None;
        while !is_over.load(Ordering::Acquire) {
            py.detach(|| thread::park_timeout(LOOK));
            if failed.is_some() {
                continue; // it stops at its next step
            }
            let shown = shown.as_mut().map_or(Ok(()), |shown| shown.show(&watch.far));
            if let Err(error) = py.check_signals().and(shown) {
                watch.stop.store(true, Ordering::Relaxed);
                failed = Some(error);
            }
        }
        let done = py.detach(|| worker.join());
        match (done, failed) {
            (Err(panic), _) => std::panic::resume_unwind(panic),
            (Ok(_), Some(error)) => Err(error),
            (Ok(done), None) => {
                shown.as_mut().map_or(Ok(()), |shown| shown.show(&watch.far))?;
                Ok(done)
            }
        }
    })
}
