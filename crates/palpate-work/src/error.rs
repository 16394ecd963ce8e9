//! Errors of this crate.

use std::io;
use std::path::{Path, PathBuf};

use palpate::MapperError;
use palpate_io::log::LogError;

use crate::settings::SettingsError;

/// Why work could not be done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum WorkError {
    /// A request that cannot be carried out.
    #[error("{0}")]
    Usage(String),
    #[error(transparent)]
    Settings(#[from] SettingsError),
    #[error(transparent)]
    Log(#[from] LogError),
    /// A robot, a field or another file that cannot be used; the message says which and why.
    #[error("{0}")]
    File(Box<dyn std::error::Error + Send + Sync>),
    /// A log that looks wrong, if that is to be an error (`strict`).
    #[error("{0}")]
    LooksWrong(String),
    /// Touches that cannot be used.
    #[error("`{}`: {place}: {source}", log.display())]
    Touch { log: PathBuf, place: String, source: Box<MapperError> },
    /// Results that cannot be written.
    #[error("{what} cannot be written: {source}")]
    Write { what: String, source: io::Error },
    /// The work was stopped, for example by Ctrl-C.
    #[error("interrupted{kept}")]
    Interrupted { kept: String },
}

impl WorkError {
    /// The error for a file that cannot be used.
    pub fn file(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::File(Box::new(error))
    }

    /// The error for a touch of a log that cannot be used.
    pub fn touch(log: &Path, place: String, source: impl Into<MapperError>) -> Self {
        Self::Touch { log: log.to_owned(), place, source: Box::new(source.into()) }
    }
}

/// The message of an error, then those of its causes that are not already part of a message before them.
pub fn with_causes(error: &dyn std::error::Error) -> Vec<String> {
    let mut lines = vec![error.to_string()];
    let mut cause = error.source();
    while let Some(error) = cause {
        let text = error.to_string();
        if !lines.iter().any(|line| line.contains(&text)) {
            lines.push(text);
        }
        cause = error.source();
    }
    lines
}

impl From<String> for WorkError {
    fn from(message: String) -> Self {
        Self::File(message.into())
    }
}
