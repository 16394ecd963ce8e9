//! What a log says: touches and samples one after another, and what is known of the log itself.

use std::path::PathBuf;

use palpate::Sample;
use serde::Serialize;

use super::error::LogError;
use super::options::CsvColumns;

/// One thing that happens in a log.
#[derive(Debug, Clone, PartialEq)]
pub enum LogEvent {
    /// A touch starts; the one before it, if any, has ended.
    TouchStarts {
        /// Name of the touch: its folder, file or cell.
        name: String,
        /// Names of the joints in the order of the samples, if the log knows them.
        joint_names: Option<Vec<String>>,
    },
    /// One moment of the touch that started last.
    Sample(Sample),
}

/// A log being read. After an error it yields nothing more.
pub trait Log: Iterator<Item = Result<LogEvent, LogError>> + Send {
    /// What is known of the log before and while it is read.
    fn describe(&self) -> LogDescription;

    /// What looked odd so far but did not stop the reading.
    fn warnings(&self) -> &[LogWarning];
}

/// What a log says of itself, for progress bars and `inspect`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LogDescription {
    /// Where it is.
    pub path: PathBuf,
    /// Its format.
    pub format: Format,
    /// Number of touches, if known before reading.
    pub touches: Option<usize>,
    /// Number of samples in all touches, if known before reading.
    pub samples: Option<u64>,
    /// Number of joints, if known before reading.
    pub joints: Option<usize>,
    /// What the log says of its torques.
    pub torques: LoggedTorques,
    /// The columns that are read, of the first file, if it is a table; two columns of one time are joined by `and`.
    pub columns: Option<CsvColumns>,
}

/// What a log says of its torques.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LoggedTorques {
    /// Nothing: they may hold gravity.
    #[default]
    Unsaid,
    /// They are external ones: gravity has been taken out.
    External,
    /// They are motor currents, in ampere.
    Currents,
}

/// The formats of logs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum Format {
    /// One folder with `angles.npy` and `torques.npy`, or a folder of such folders.
    NpyFolder,
    /// One table, or a folder of them.
    Csv,
    /// Bag of ROS 2 as MCAP.
    Mcap,
    /// Bag of ROS 2 as SQLite.
    Rosbag2Sqlite,
    /// Parquet, such as LeRobot's.
    Parquet,
    /// Touches that a program holds: no file.
    Memory,
}

/// Something odd in a log that did not stop the reading.
#[derive(Debug, Clone, PartialEq, Serialize, thiserror::Error)]
#[non_exhaustive]
pub enum LogWarning {
    /// The clock of a touch stood still or ran backwards; one warning for each touch.
    #[error(
        "touch `{touch}`: the clock goes from {before_s} s to {now_s} s in row {row} (from 0), and \
         does not advance {count} times in all; the order of the rows was believed"
    )]
    TimeNotIncreasing {
        /// Name of the touch.
        touch: String,
        /// First sample whose time is not after that of the one before it, counted from 0.
        row: u64,
        /// Time of the sample before, s.
        before_s: f64,
        /// Time of the sample, s.
        now_s: f64,
        /// How many samples of the touch do so.
        count: u64,
    },
    /// Messages of a bag that gave no sample.
    #[error(
        "messages that gave no sample: {other_joints} of other joints, {before_touch} before the \
         first touch starts"
    )]
    LeftOut {
        /// Those of other joints.
        other_joints: u64,
        /// Those before the first touch starts.
        before_touch: u64,
    },
    /// Rows of a table that belong to no touch.
    #[error("{rows} rows were left out: their touch column is empty")]
    BetweenTouches {
        /// How many.
        rows: u64,
    },
    /// A bag that breaks off, read up to there.
    #[error(
        "the bag breaks off after {messages} messages and {seconds:.1} s ({reason}); what lies \
         before was read"
    )]
    BrokenOff {
        /// Messages that could be read.
        messages: u64,
        /// From the first to the last of them, s.
        seconds: f64,
        /// What stopped the reading.
        reason: String,
    },
}
