//! What can be wrong with a cloud's file.

use std::io;
use std::path::PathBuf;

use crate::npy::NpyError;

/// What can be wrong with a cloud.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum CloudError {
    /// The system refused to read.
    #[error("`{path}` cannot be read: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// An array of the truth that cannot be read.
    #[error("`{path}` {source}")]
    Npy { path: PathBuf, source: NpyError },
    /// Neither of the two formats.
    #[error("`{path}` is no cloud: it begins with {found}; wanted a PLY or PCD file")]
    NotCloud { path: PathBuf, found: String },
    /// A header that says too little, or contradicts itself.
    #[error("`{path}` has a header that cannot be used, line {line}: {reason}")]
    Header { path: PathBuf, line: usize, reason: String },
    /// A cloud without coordinates.
    #[error(
        "`{path}` holds no points: wanted the numbers x, y and z of {of}, found {found}; export it \
         with positions"
    )]
    NoPositions { path: PathBuf, of: &'static str, found: String },
    /// Fewer bytes than promised.
    #[error(
        "`{path}` is truncated: it holds {held} of the {promised} {unit} that its header promises; \
         copy it again"
    )]
    Truncated { path: PathBuf, held: u64, promised: u64, unit: String },
    /// A number that cannot be what it is called.
    #[error("`{path}`: {place} is {found}; wanted {wanted}")]
    Value { path: PathBuf, place: String, found: String, wanted: &'static str },
    /// Nothing to see.
    #[error("`{path}` holds no finite point; {dropped} that are not finite were dropped")]
    Empty { path: PathBuf, dropped: usize },
    /// Compressed bytes that do not unpack to what was promised.
    #[error("`{path}` is damaged: {reason}; copy it again")]
    Damaged { path: PathBuf, reason: String },
}
