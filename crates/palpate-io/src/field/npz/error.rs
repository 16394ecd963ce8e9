//! What can be wrong with an npz file.

use std::io;
use std::path::PathBuf;

use crate::atomic::WriteError;
use crate::input;
use crate::npy::NpyError;

/// Largest number of members of an archive; one with more is refused.
pub(super) const MAX_MEMBERS: usize = 1024;

/// What can be wrong with an npz file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum NpzError {
    /// The operating system reported an error.
    #[error("`{path}` cannot be read: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// Not a zip archive, or a broken one.
    #[error("`{path}` is not an npz file, or is truncated: {reason}")]
    NotNpz { path: PathBuf, reason: String },
    /// A member that is broken.
    #[error("`{path}`: the array `{name}` {source}")]
    Member { path: PathBuf, name: String, source: NpyError },
    /// Arrays that exceed the memory limit.
    #[error("`{path}` needs {}", input::too_large())]
    TooLarge { path: PathBuf },
    /// More members than are accepted.
    #[error("`{path}` holds {found} arrays; wanted at most {MAX_MEMBERS}")]
    TooMany { path: PathBuf, found: usize },
    /// A required array is missing.
    #[error("`{path}` holds no array `{name}`: {held}")]
    NoArray { path: PathBuf, name: String, held: String },
    /// An array with a wrong shape or type.
    #[error("`{path}`: the array `{name}` is {found}; wanted {wanted}")]
    Array { path: PathBuf, name: String, found: String, wanted: String },
    /// A number outside of the valid range.
    #[error("`{path}`: the array `{name}` holds {found} in row {row} (from 0); wanted {wanted}")]
    Value { path: PathBuf, name: String, row: usize, found: f64, wanted: &'static str },
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}
