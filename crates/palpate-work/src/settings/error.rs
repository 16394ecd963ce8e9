//! What can be wrong with settings.

use std::path::PathBuf;

use palpate::{LatticeError, MapperError, RobotError};

/// What can be wrong with settings.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum SettingsError {
    /// The file cannot be read.
    #[error("the settings file `{}` cannot be read: {source}", path.display())]
    Unreadable { path: PathBuf, source: std::io::Error },
    /// Not TOML, or a value of the wrong kind.
    #[error("the settings file `{}` has an error\n{message}", path.display())]
    Toml { path: PathBuf, message: String },
    /// A key that does not exist.
    #[error("`{}`, line {line}: there is no setting `{key}`{remedy}", path.display())]
    UnknownKey { path: PathBuf, line: usize, key: String, remedy: String },
    /// A value outside its range.
    #[error("bad setting: {0}")]
    Value(Box<MapperError>),
    /// A value that the core accepts, but that costs hours or ruins the surface.
    #[error("bad setting: {key} is {found}; it must be at most {limit}: {reason}")]
    TooLarge { key: &'static str, found: f64, limit: f64, reason: &'static str },
    /// An invalid lattice.
    #[error("bad lattice: {0}")]
    Lattice(#[from] LatticeError),
    /// An invalid payload.
    #[error("bad payload: {0}")]
    Payload(#[from] RobotError),
    /// Settings that need or exclude each other.
    #[error("{0}")]
    Together(String),
}

impl SettingsError {
    /// The error for a value that the core refuses.
    pub fn value(error: impl Into<MapperError>) -> Self {
        Self::Value(Box::new(error.into()))
    }
}
