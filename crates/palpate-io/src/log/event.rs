//! Events of a log (touches and samples in order), its description and its warnings.

use std::path::PathBuf;

use palpate::{Sample, TorqueSign};
use serde::Serialize;

use super::error::LogError;
use super::options::{AngleUnit, CsvColumns, TimeUnit};

/// One event of a log.
#[derive(Debug, Clone, PartialEq)]
pub enum LogEvent {
    /// A touch starts; the one before it, if any, has ended.
    TouchStarts {
        /// Name of the touch: its folder, file or cell.
        name: String,
        /// Names of the joints in the order of the samples, if the log contains them.
        joint_names: Option<Vec<String>>,
    },
    /// A sample of the touch that started last.
    Sample(Sample),
}

/// A log being read. After an error, the iterator ends.
pub trait Log: Iterator<Item = Result<LogEvent, LogError>> + Send {
    /// Description of the log, available before and during reading.
    fn describe(&self) -> LogDescription;

    /// Problems found so far that did not stop the reading.
    fn warnings(&self) -> &[LogWarning];

    /// The unit of times that was found from the first samples, if it is another than names of columns and the size of
    /// the first time suggest; `None` before the first sample was read.
    fn found_time_unit(&self) -> Option<TimeUnit> {
        None
    }
}

/// Description of a log, for progress bars and `inspect`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LogDescription {
    /// Path of the log.
    pub path: PathBuf,
    /// Format of the log.
    pub format: LogFormat,
    /// Number of touches, if known before reading.
    pub touches: Option<usize>,
    /// Number of samples in all touches, if known before reading.
    pub samples: Option<u64>,
    /// Number of joints, if known before reading.
    pub joints: Option<usize>,
    /// Kind of the logged torques.
    pub torques: LoggedTorques,
    /// Unit of the positions in the file, if the names of columns or the type of message say it.
    pub angle_unit: Option<AngleUnit>,
    /// The columns that are read, for a table: those of its first file; two columns of one time are joined by `and`.
    pub columns: Option<CsvColumns>,
}

/// Kind of the logged torques, as far as the log says.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LoggedTorques {
    /// Not said: they may contain gravity.
    #[default]
    Unknown,
    /// External torques: gravity has been subtracted. With their sign, if the maker's convention is known.
    External(Option<TorqueSign>),
    /// Motor currents, A.
    Currents,
}

/// The formats of logs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum LogFormat {
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
    /// Touches in the memory of a program, not in a file.
    Memory,
}

/// A problem in a log that did not stop the reading.
#[derive(Debug, Clone, PartialEq, Serialize, thiserror::Error)]
#[non_exhaustive]
pub enum LogWarning {
    /// The clock of a touch stood still or ran backwards; one warning for each touch.
    #[error(
        "touch `{touch}`: the clock goes from {before_s} s to {now_s} s in row {row} (from 0), and \
         does not advance {count} times in all; the rows were used in their order"
    )]
    TimeNotIncreasing {
        /// Name of the touch.
        touch: String,
        /// Number of the first sample whose time is not after that of the previous sample, from 0.
        row: u64,
        /// Time of the previous sample, s.
        before_s: f64,
        /// Time of this sample, s.
        now_s: f64,
        /// Number of such samples in the touch.
        count: u64,
    },
    /// Messages of a bag that were not used as samples.
    #[error(
        "messages that gave no sample: {other_joints} of other joints, {before_touch} before the \
         first touch starts"
    )]
    LeftOut {
        /// Number of messages that do not contain all joints that are read.
        other_joints: u64,
        /// Number of messages before the first touch starts.
        before_touch: u64,
    },
    /// Rows of a table that belong to no touch.
    #[error("{rows} rows were left out: their touch column is empty")]
    BetweenTouches {
        /// Number of these rows.
        rows: u64,
    },
    /// A bag that breaks off; it was read up to the break.
    #[error(
        "the bag breaks off after {messages} messages and {seconds:.1} s ({reason}); the \
         messages before this place were read"
    )]
    BrokenOff {
        /// Number of messages that could be read.
        messages: u64,
        /// Time from the first to the last sample, s.
        seconds: f64,
        /// Error that stopped the reading.
        reason: String,
    },
}
