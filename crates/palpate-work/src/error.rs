//! What ends work early.

use std::io;
use std::path::{Path, PathBuf};

use palpate::MapperError;
use palpate_io::log::LogError;

use crate::settings::SettingsError;

/// Why something could not be done as it was asked for.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum WorkError {
    /// Requests that cannot be followed.
    #[error("{0}")]
    Usage(String),
    #[error(transparent)]
    Settings(#[from] SettingsError),
    #[error(transparent)]
    Log(#[from] LogError),
    /// A robot, a field or another file that is not what it should be; the message says which.
    #[error("{0}")]
    File(Box<dyn std::error::Error + Send + Sync>),
    /// A log that looks wrong, where that was to be an error.
    #[error("{0}")]
    LooksWrong(String),
    /// Touches that cannot be used.
    #[error("`{}`: {place}: {source}", log.display())]
    Touch { log: PathBuf, place: String, source: Box<MapperError> },
    /// Results that cannot be handed over.
    #[error("{what} cannot be written: {source}")]
    Write { what: String, source: io::Error },
    /// Ctrl-C.
    #[error("interrupted{kept}")]
    Interrupted { kept: String },
}

impl WorkError {
    /// A file that is not what it should be.
    pub fn file(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::File(Box::new(error))
    }

    /// A touch of a log that cannot be used.
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
