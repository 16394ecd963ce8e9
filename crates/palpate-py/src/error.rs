//! Every error as a Python exception, with the text that the command prints.

use std::error::Error;

use palpate_work::error::told;
use palpate_work::{WorkError, settings};
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt, PyUserWarning};
use pyo3::prelude::*;

create_exception!(palpate, PalpateError, PyException, "What palpate could not do, and why.");
create_exception!(
    palpate,
    SettingsError,
    PalpateError,
    "Settings or a request that cannot be followed."
);
create_exception!(palpate, LogError, PalpateError, "A log that cannot be read.");
create_exception!(
    palpate,
    FileError,
    PalpateError,
    "A robot, a field or another file that is not what it should be."
);
create_exception!(
    palpate,
    TouchError,
    PalpateError,
    "A sample, a touch or a path that cannot be used."
);
create_exception!(
    palpate,
    PalpateWarning,
    PyUserWarning,
    "Something looks wrong, though it did not stop the work."
);

/// An error and its causes as one text.
fn text(error: &dyn Error) -> String {
    told(error).join("\n  because ")
}

/// The exception of an error.
pub(crate) fn raise(error: &WorkError) -> PyErr {
    let text = text(error);
    match error {
        WorkError::Usage(_) | WorkError::Settings(_) => SettingsError::new_err(text),
        WorkError::Log(_) => LogError::new_err(text),
        WorkError::File(_) | WorkError::Write { .. } => FileError::new_err(text),
        WorkError::Touch { .. } => TouchError::new_err(text),
        WorkError::Interrupted { .. } => PyKeyboardInterrupt::new_err(()),
        _ => PalpateError::new_err(text),
    }
}

/// The exception of a file that is not what it should be.
pub(crate) fn of_file(error: &dyn Error) -> PyErr {
    FileError::new_err(text(error))
}

/// The exception of a sample or a path that cannot be used.
pub(crate) fn of_touch(error: &dyn Error) -> PyErr {
    TouchError::new_err(text(error))
}

/// The exception of settings that cannot be.
pub(crate) fn of_settings(error: &dyn Error) -> PyErr {
    SettingsError::new_err(text(error))
}

/// The same, for `map_err`.
pub(crate) fn of_bad_settings(error: settings::SettingsError) -> PyErr {
    of_settings(&error)
}
