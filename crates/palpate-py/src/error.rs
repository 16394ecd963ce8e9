//! Converts errors to Python exceptions, with the same text as the command prints.

use std::error::Error;

use palpate::{LatticeError, MapperError, PathError, RobotError};
use palpate_io::cloud::CloudError;
use palpate_io::field::{SavedError, npz::NpzError};
use palpate_learn::extrapolate::ExtrapolateError;
use palpate_work::WorkError;
use palpate_work::error::with_causes;
use palpate_work::field_arrays::FieldArraysError;
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt, PyUserWarning, PyValueError};
use pyo3::prelude::*;

create_exception!(palpate, PalpateError, PyException, "Base class of the errors of palpate.");
create_exception!(
    palpate,
    SettingsError,
    PalpateError,
    "Settings or arguments that are invalid or contradict each other."
);
create_exception!(
    palpate,
    LogError,
    PalpateError,
    "A log that cannot be read, or that looks wrong while `strict` is set."
);
create_exception!(
    palpate,
    FileError,
    PalpateError,
    "A robot, field or other file that is missing or invalid, or cannot be written."
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

/// An error, converted to a Python exception.
#[derive(Debug)]
pub(crate) struct Raised(PyErr);

/// A result whose error becomes a Python exception.
pub(crate) type Result<T, E = Raised> = std::result::Result<T, E>;

impl From<PyErr> for Raised {
    fn from(error: PyErr) -> Self {
        Self(error)
    }
}

impl From<Raised> for PyErr {
    fn from(Raised(error): Raised) -> Self {
        error
    }
}

impl From<WorkError> for Raised {
    fn from(error: WorkError) -> Self {
        let text = text(&error);
        Self(match error {
            WorkError::Usage(_) | WorkError::Settings(_) => SettingsError::new_err(text),
            WorkError::Log(_) | WorkError::LooksWrong(_) => LogError::new_err(text),
            WorkError::File(_) | WorkError::Write { .. } => FileError::new_err(text),
            WorkError::Touch { .. } => TouchError::new_err(text),
            WorkError::Interrupted { .. } => PyKeyboardInterrupt::new_err(()),
            _ => PalpateError::new_err(text),
        })
    }
}

/// Implements the conversion of the listed errors to an exception.
macro_rules! exceptions {
    ($($exception:ident of $($error:ty),+;)+) => {$($(
        impl From<$error> for Raised {
            fn from(error: $error) -> Self {
                Self($exception::new_err(text(&error)))
            }
        }
    )+)+};
}

exceptions! {
    SettingsError of palpate_work::settings::SettingsError, LatticeError, ExtrapolateError;
    FileError of SavedError, NpzError, CloudError;
    TouchError of MapperError, RobotError, PathError;
    PyValueError of FieldArraysError;
}

/// An error and its causes as one text.
fn text(error: &dyn Error) -> String {
    with_causes(error).join("\n  because ")
}
