//! Converts errors to Python exceptions, with the text that the command prints and keywords in place of flags.

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
    in_keywords(&with_causes(error).join("\n  because "))
}

/// A message of the command with Python's keywords in place of flags: `torque_sign` for `--torque-sign`, `tare=False`
/// for `--no-tare`. Commands in backticks (`palpate map LOG --cloud CLOUD`) stay as they are.
pub(crate) fn in_keywords(message: &str) -> String {
    let parts = message.split('`').enumerate().map(|(number, part)| match number % 2 {
        0 => without_flags(part, "`"),
        _ if part.starts_with("--") => without_flags(part, ""),
        _ => part.to_owned(),
    });
    parts.collect::<Vec<_>>().join("`")
}

/// Replaces flags by keywords between `quotes`.
fn without_flags(text: &str, quotes: &str) -> String {
    let mut replaced = String::new();
    let mut rest = text;
    while let Some(at) = rest.find("--") {
        let (before, flag) = rest.split_at(at);
        let is_word = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
        let end = flag.find(|c| !is_word(c)).unwrap_or(flag.len());
        let name = &flag[2..end];
        let starts_word = before.is_empty() || before.ends_with([' ', '(']);
        let keyword = match name.strip_prefix("no-") {
            Some(name) => format!("{quotes}{}=False{quotes}", name.replace('-', "_")),
            None => format!("{quotes}{}{quotes}", name.replace('-', "_")),
        };
        let is_flag = starts_word && name.starts_with(|c: char| c.is_ascii_lowercase());
        replaced += before;
        replaced += if is_flag { &keyword } else { &flag[..end] };
        rest = &flag[end..];
    }
    replaced + rest
}
