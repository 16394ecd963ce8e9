//! What ends a command early, and the exit code that says so.

use std::io;
use std::path::PathBuf;

use palpate::mapper::MapperError;
use palpate_io::log::LogError;

use crate::settings::SettingsError;

/// Why a command could not do what it was asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub(crate) enum CliError {
    /// Flags that cannot be followed.
    #[error("{0}")]
    Usage(String),
    #[error(transparent)]
    Settings(#[from] SettingsError),
    #[error(transparent)]
    Log(#[from] LogError),
    /// A robot, a field or another file that is not what it should be; the message says which.
    #[error("{0}")]
    File(Box<dyn std::error::Error + Send + Sync>),
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

impl CliError {
    /// A file that is not what it should be.
    pub(crate) fn file(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::File(Box::new(error))
    }

    /// What the shell is told: 1 for data and files, 2 for usage, 130 for Ctrl-C, and nothing
    /// wrong when a reader such as `head` has seen enough.
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) | Self::Settings(_) => 2,
            Self::Interrupted { .. } => 130,
            Self::Write { source, .. } if source.kind() == io::ErrorKind::BrokenPipe => 0,
            _ => 1,
        }
    }
}

impl From<String> for CliError {
    fn from(message: String) -> Self {
        Self::File(message.into())
    }
}
