//! Errors of logs, with their remedies.

use std::io;
use std::path::{Path, PathBuf};

use crate::input;
use crate::npy::NpyError;

/// What can be wrong with a log.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum LogError {
    /// The path does not exist.
    #[error("`{path}` does not exist; {remedy}")]
    Missing { path: PathBuf, remedy: String },
    /// The operating system reported an error.
    #[error("`{path}` cannot be read: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// A file or folder that is not a log.
    #[error("`{path}` holds no touch: {found}; wanted {wanted}")]
    NoTouch { path: PathBuf, found: String, wanted: &'static str },
    /// A file that is not an npy array, or a broken one.
    #[error("`{path}` {source}")]
    Npy { path: PathBuf, source: NpyError },
    /// An array whose shape is wrong or does not fit the other arrays.
    #[error("`{path}` has the shape {found:?}; wanted {wanted}")]
    Shape { path: PathBuf, found: Vec<u64>, wanted: String },
    /// A touch without a single sample.
    #[error("`{path}` is empty: it holds no frame; record again or remove it")]
    Empty { path: PathBuf },
    /// A number that is not finite.
    #[error(
        "`{path}` holds {found} in row {row}, column {column} (both counted from 0); every number \
         must be finite: cut the row out of every file of the touch, or record again"
    )]
    NotFinite { path: PathBuf, row: u64, column: usize, found: f64 },
    /// A table that cannot be read.
    #[error(transparent)]
    Table(#[from] TableError),
    /// A bag that cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// Touches are to be split at gaps in time, but the log has no time.
    #[error(
        "`{path}` has no time stamps, so it cannot be split at gaps in time; leave --split-gap-s out"
    )]
    NoClock { path: PathBuf },
}

impl LogError {
    /// The error of a path that cannot be opened or read.
    pub(super) fn reading(path: &Path, source: io::Error) -> Self {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::NotFound => Self::Missing {
                path,
                remedy: "check the spelling and the current folder".to_owned(),
            },
            _ => Self::Io { path, source },
        }
    }
}

/// What can be wrong with a table: CSV or Parquet.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum TableError {
    /// A file that is not a table of text.
    #[error("`{path}` {reason}; wanted rows of numbers below a line of column names")]
    NotCsv { path: PathBuf, reason: String },
    /// A file that is not Parquet, or a broken one.
    #[error("`{path}` is not a Parquet file, or is damaged: {reason}; copy it again")]
    NotParquet { path: PathBuf, reason: String },
    /// Parquet with an unsupported compression.
    #[error(
        "`{path}`: its columns are compressed by {codec}, which is not read; write them with zstd, snappy, gzip or lz4"
    )]
    Compressed { path: PathBuf, codec: String },
    /// Parquet, in a build without the feature `formats`.
    #[error("`{path}` is Parquet: {}", crate::not_built("Parquet"))]
    NotBuilt { path: PathBuf },
    /// Rows that exceed the memory limit.
    #[error("`{path}`: its row group {group} (from 0) needs {}", input::too_large())]
    TooLarge { path: PathBuf, group: usize },
    /// Columns that are missing or ambiguous.
    #[error(
        "`{path}`: {reason}. Its columns are {header}. Name those to read with --columns, \
         or in the settings of the log{example}; leave out `time` or `touch` if there is no such column"
    )]
    Columns { path: PathBuf, reason: String, header: String, example: &'static str },
    /// A row that is longer or shorter than the header.
    #[error("`{path}` has {found} cells in line {line}; wanted {wanted} as in its header")]
    Row { path: PathBuf, line: u64, found: usize, wanted: usize },
    /// A row whose joints differ from those of the rows before.
    #[error(
        "`{path}` has the joints {found} in line {line}; wanted {wanted} as before: if several \
         robots were recorded in one table, make one table for each"
    )]
    OtherJoints { path: PathBuf, line: u64, found: String, wanted: String },
    /// A cell of a text table that is not a finite number.
    #[error(
        "`{path}` holds {found} in line {line}, column `{column}`; every number must be finite, \
         with a decimal point: correct the line or cut it out"
    )]
    Cell { path: PathBuf, line: u64, column: String, found: String },
    /// A value of Parquet that cannot be used.
    #[error("`{path}`, row {row} (from 0), column `{column}`: {reason}")]
    Value { path: PathBuf, row: u64, column: String, reason: String },
    /// Files of one log with different kinds of torques.
    #[error(
        "`{path}`: this file and those before it hold different quantities: measured torques, external \
         torques of one maker or another, or motor currents; read the files of each kind separately"
    )]
    CurrentsAndTorques { path: PathBuf },
    /// A touch column that is empty in all rows.
    #[error(
        "`{path}` has a touch column that is empty in all rows; name the touches in it, or leave it out"
    )]
    NoTouch { path: PathBuf },
    /// A touch whose rows are not contiguous.
    #[error("`{path}` goes back to touch `{touch}` in {place}; sort the rows by touch and time")]
    TouchResumes { path: PathBuf, place: String, touch: String },
}

impl TableError {
    /// The error for missing or ambiguous columns; of the header, at most 40 names are shown.
    pub(super) fn columns(
        path: &Path,
        reason: String,
        header: &[String],
        example: &'static str,
    ) -> Self {
        let mut names: Vec<String> =
            header.iter().take(40).map(|name| format!("`{name}`")).collect();
        if header.len() > 40 {
            names.push(format!("{} more", header.len() - 40));
        }
        Self::Columns { path: path.to_owned(), reason, header: names.join(", "), example }
    }
}

/// What can be wrong with a bag.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum BagError {
    /// A file that cannot be read as a bag.
    #[error("`{path}` {reason}")]
    Storage { path: PathBuf, reason: String },
    /// A topic that is missing, unsuitable or ambiguous.
    #[error("`{path}`: {reason}. Its topics are {topics}. Name the one to read with --topic")]
    Topic { path: PathBuf, reason: String, topics: String },
    /// A message type whose definition cannot be interpreted.
    #[error("`{path}`: topic `{topic}` holds messages of `{kind}`, but {reason}")]
    Layout { path: PathBuf, topic: String, kind: String, reason: String },
    /// A message that cannot be used.
    #[error("`{path}`: message {message} (from 0) of topic `{topic}`: {reason}")]
    Message { path: PathBuf, topic: String, message: u64, reason: String },
    /// A bag that breaks off.
    #[error(
        "`{path}` breaks off after {messages} messages of topic `{topic}` and {seconds:.1} s: \
         {reason}. The messages before this place can be read with --until-break"
    )]
    Broken { path: PathBuf, topic: String, messages: u64, seconds: f64, reason: String },
}
