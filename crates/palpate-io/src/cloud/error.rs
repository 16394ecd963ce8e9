//! Errors of files of clouds.

use std::io;
use std::path::PathBuf;

use crate::npy::NpyError;

/// What can be wrong with a cloud.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum CloudError {
    /// The operating system reported an error.
    #[error("`{path}` cannot be read: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// An array of true values that cannot be read.
    #[error("`{path}` {source}")]
    Npy { path: PathBuf, source: NpyError },
    /// Neither of the two formats.
    #[error("`{path}` is not a point cloud: it begins with {found}; wanted a PLY or PCD file")]
    NotCloud { path: PathBuf, found: String },
    /// A header that is incomplete or inconsistent.
    #[error("`{path}` has a header that cannot be used, line {line}: {reason}")]
    Header { path: PathBuf, line: usize, reason: String },
    /// A cloud without coordinates.
    #[error(
        "`{path}` holds no points: wanted the numbers x, y and z of {of}, found {found}; export it \
         with positions"
    )]
    NoPositions { path: PathBuf, of: &'static str, found: String },
    /// Fewer bytes than the header says.
    #[error(
        "`{path}` is truncated: it holds {held} of the {promised} {unit} that its header promises; \
         copy it again"
    )]
    Truncated { path: PathBuf, held: u64, promised: u64, unit: String },
    /// An invalid number.
    #[error("`{path}`: {place} is {found}; wanted {wanted}")]
    Value { path: PathBuf, place: String, found: String, wanted: &'static str },
    /// A cloud without finite points.
    #[error("`{path}` holds no finite point; {dropped} that are not finite were dropped")]
    Empty { path: PathBuf, dropped: usize },
    /// Compressed data that do not unpack to the size in the header.
    #[error("`{path}` is damaged: {reason}; copy it again")]
    Damaged { path: PathBuf, reason: String },
}
