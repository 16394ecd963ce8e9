//! What can be wrong with an npz file.

use std::io;
use std::path::PathBuf;

use crate::atomic::WriteError;
use crate::input;
use crate::npy::NpyError;

/// Most members that one archive may have.
pub(super) const MAX_MEMBERS: usize = 1024;

/// What can be wrong with an npz file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum NpzError {
    /// The system refused to read.
    #[error("`{path}` cannot be read: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// Not a zip archive, or a broken one.
    #[error("`{path}` is not an npz file, or is truncated: {reason}")]
    NotNpz { path: PathBuf, reason: String },
    /// A member that is broken.
    #[error("`{path}`: the array `{name}` {source}")]
    Member { path: PathBuf, name: String, source: NpyError },
    /// More than is read.
    #[error("`{path}` wants {}", input::too_large())]
    TooLarge { path: PathBuf },
    /// More arrays than any field has.
    #[error("`{path}` holds {found} arrays; wanted at most {MAX_MEMBERS}")]
    TooMany { path: PathBuf, found: usize },
    /// An array that is needed is not there.
    #[error("`{path}` holds no array `{name}`: {held}")]
    NoArray { path: PathBuf, name: String, held: String },
    /// An array of another shape or kind than wanted.
    #[error("`{path}`: the array `{name}` is {found}; wanted {wanted}")]
    Array { path: PathBuf, name: String, found: String, wanted: String },
    /// A number that makes no sense.
    #[error("`{path}`: the array `{name}` holds {found} in row {row} (from 0); wanted {wanted}")]
    Value { path: PathBuf, name: String, row: usize, found: f64, wanted: &'static str },
    /// It could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}
