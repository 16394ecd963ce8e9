//! Logs: what a robot recorded while it touched an object, as a stream of events.
//!
//! A log is read from its beginning to its end and never held whole, so that a file of any length,
//! a bag and a running robot all look the same: a touch starts, its samples follow, the next touch
//! starts. A touch ends where the next one starts or the log ends.
//!
//! | layout                                       | module         |
//! |----------------------------------------------|----------------|
//! | folder with `angles.npy`, `torques.npy`      | `npy_folder`   |
//! | folder of such folders (also OpenVSF's)      | `npy_folder`   |
//! | `.csv`, or a folder of them                  | `csv`          |
//! | bag of ROS 2: `.mcap`, `.db3`, their folder  | `bag`          |
//! | `.parquet`, or a data set of LeRobot         | `parquet`      |
//!
//! `gap` parts touches of any of them where the clock leaps.
//!
//! Torques are handed on as logged: neither gravity nor bias is known here. `truth/` beside the
//! touches is read by [`external_truth`] alone, never by a log.

mod bag;
mod csv;
mod gap;
mod joints;
mod natural;
mod npy_folder;
mod parquet;
mod truth;
pub mod write;

use crate::npy::NpyError;
use serde::{Deserialize, Serialize};
use std::io;
use std::path::{Path, PathBuf};

pub use bag::BagError;
pub use bag::write as bag_write;
pub use csv::{CsvColumns, CsvError};
pub use palpate::Sample;

pub use joints::{JointNameError, reorder};
pub use parquet::ParquetError;
pub use truth::{external_truth, is_simulated};

/// More joints than any arm has: an array this wide is something else, or turned on its side.
pub(crate) const MAX_JOINTS: usize = 64;

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

/// How to read a log.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LogOptions {
    /// Which columns of a table to read; `None` recognises common spellings.
    pub columns: Option<CsvColumns>,
    /// Unit of the logged joint positions.
    pub angle_unit: AngleUnit,
    /// Topic of a bag that holds the samples; `None` takes the only one that can be read.
    pub topic: Option<String>,
    /// Topic of a bag whose messages each start a touch.
    pub touch_topic: Option<String>,
    /// Joints of a bag to read, by name; `None` takes those of the message that has most.
    pub joints: Option<Vec<String>>,
    /// Starts a new touch where two samples lie further apart than this, s.
    pub split_gap_s: Option<f64>,
    /// Reads a bag that breaks off up to there, as if it ended.
    pub until_break: bool,
}

/// Unit of logged joint positions.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AngleUnit {
    /// Radians; prismatic joints in metres.
    #[default]
    Rad,
    /// Degrees, for every joint: a log of a robot with a prismatic joint must be in radians.
    Deg,
}

impl AngleUnit {
    /// Turns logged positions into radians.
    pub(crate) fn into_rad(self, q: &mut [f64]) {
        if self == Self::Deg {
            q.iter_mut().for_each(|angle| *angle = angle.to_radians());
        }
    }
}

/// Something odd in a log that did not stop the reading.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[non_exhaustive]
pub enum LogWarning {
    /// The clock of a touch stood still or ran backwards; told once a touch.
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
    LeftOut {
        /// Those of other joints.
        other_joints: u64,
        /// Those before the first touch starts.
        before_touch: u64,
    },
    /// A bag that breaks off, read up to there.
    BrokenOff {
        /// Messages that could be read.
        messages: u64,
        /// From the first to the last of them, s.
        seconds: f64,
        /// What stopped the reading.
        reason: String,
    },
}

impl std::fmt::Display for LogWarning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::TimeNotIncreasing { touch, row, before_s, now_s, count } => write!(
                f,
                "touch `{touch}`: the clock goes from {before_s} s to {now_s} s in row {row} (from \
                 0), and does not advance {count} times in all; the order of the rows was believed"
            ),
            Self::LeftOut { other_joints, before_touch } => write!(
                f,
                "messages that gave no sample: {other_joints} of other joints, {before_touch} \
                 before the first touch starts"
            ),
            Self::BrokenOff { messages, seconds, reason } => write!(
                f,
                "the bag breaks off after {messages} messages and {seconds:.1} s ({reason}); what \
                 lies before was read"
            ),
        }
    }
}

/// What can be wrong with a log.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum LogError {
    /// Nothing is there.
    #[error("`{path}` does not exist; {remedy}")]
    Missing { path: PathBuf, remedy: String },
    /// The system refused to read.
    #[error("`{path}` cannot be read: {source}")]
    Io { path: PathBuf, source: io::Error },
    /// A file or folder that is no log.
    #[error("`{path}` holds no touch: {found}; wanted {wanted}")]
    NoTouch { path: PathBuf, found: String, wanted: &'static str },
    /// A file that is no npy array, or a broken one.
    #[error("`{path}` {source}")]
    Npy { path: PathBuf, source: NpyError },
    /// An array that does not fit the others.
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
    Csv(#[from] CsvError),
    /// A bag that cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A Parquet file that cannot be read.
    #[error(transparent)]
    Parquet(#[from] ParquetError),
    /// Gaps are to part touches, and there is no time.
    #[error(
        "`{path}` has no time, by whose gaps its touches were to be parted; leave --split-gap-s out"
    )]
    NoClock { path: PathBuf },
}

/// Opens a log, whatever its format.
///
/// Headers and lengths of every file are checked before the first event, so that most defects show
/// before any work is done. A folder that holds touches as npy is read as such even if tables lie
/// beside them.
///
/// # Errors
///
/// [`LogError`], each naming the file and the remedy.
pub fn open(path: &Path, options: &LogOptions) -> Result<Box<dyn Log>, LogError> {
    let log = open_whole(path, options)?;
    Ok(match options.split_gap_s {
        Some(gap_s) => Box::new(gap::GapSplit::new(log, gap_s)),
        None => log,
    })
}

/// Opens a log with the touches that it has itself.
fn open_whole(path: &Path, options: &LogOptions) -> Result<Box<dyn Log>, LogError> {
    let metadata = path.metadata().map_err(|source| LogError::reading(path, source))?;
    if metadata.is_dir() {
        let touches = npy_folder::touches_in(path)?;
        if !touches.is_empty() {
            return Ok(Box::new(npy_folder::NpyFolders::open(path, touches, options)?));
        }
        let tables = csv::tables_in(path)?;
        if !tables.is_empty() {
            return Ok(Box::new(csv::CsvLog::open(path, tables, options)?));
        }
        if bag::is_bag(path) {
            return Ok(Box::new(bag::BagLog::open(path, options)?));
        }
        let files = parquet::files_in(path);
        if !files.is_empty() {
            return Ok(Box::new(parquet::ParquetLog::open(path, files, options)?));
        }
        return Err(no_touch(path));
    }
    if csv::is_table(path) {
        return Ok(Box::new(csv::CsvLog::open(path, vec![path.to_owned()], options)?));
    }
    if bag::is_bag(path) {
        return Ok(Box::new(bag::BagLog::open(path, options)?));
    }
    if parquet::is_parquet(path) || !parquet::files_in(path).is_empty() {
        return Ok(Box::new(parquet::ParquetLog::open(path, vec![path.to_owned()], options)?));
    }
    Err(LogError::NoTouch {
        path: path.to_owned(),
        found: "it is a file of an unknown format".to_owned(),
        wanted: WANTED,
    })
}

/// What a path must be to be a log.
const WANTED: &str = "a folder with `angles.npy` and `torques.npy`, a folder of such folders, \
                      a .csv file or a folder of .csv files, a bag of ROS 2 (.mcap, .db3 or their \
                      folder), Parquet (.parquet or a folder of them)";

/// Says what a folder holds instead of touches.
fn no_touch(path: &Path) -> LogError {
    let mut names: Vec<String> = match path.read_dir() {
        Ok(entries) => entries
            .filter_map(Result::ok)
            .map(|entry| entry.file_name().to_string_lossy().into_owned())
            .collect(),
        Err(source) => return LogError::reading(path, source),
    };
    names.sort_by(|a, b| natural::compare(a, b));
    let found = match names.as_slice() {
        [] => "it is empty".to_owned(),
        names if names.len() > 8 => {
            format!("it holds {} and {} more", names[..8].join(", "), names.len() - 8)
        }
        names => format!("it holds {}", names.join(", ")),
    };
    LogError::NoTouch { path: path.to_owned(), found, wanted: WANTED }
}

impl LogError {
    /// The error of a path that cannot be opened or read.
    pub(crate) fn reading(path: &Path, source: io::Error) -> Self {
        let path = path.to_owned();
        match source.kind() {
            io::ErrorKind::NotFound => {
                Self::Missing { path, remedy: "check the spelling and where you are".to_owned() }
            }
            _ => Self::Io { path, source },
        }
    }
}

/// Watches the clock of a touch.
#[derive(Debug, Default)]
pub(crate) struct Clock {
    before_s: Option<f64>,
    warned: bool,
}

impl Clock {
    /// Notes the time of a sample, and in `warnings` whether it is not after the one before.
    pub(crate) fn tick(
        &mut self,
        time_s: Option<f64>,
        touch: &str,
        row: u64,
        warnings: &mut Vec<LogWarning>,
    ) {
        if let (Some(before_s), Some(now_s)) = (self.before_s, time_s)
            && now_s <= before_s
        {
            match warnings.last_mut() {
                Some(LogWarning::TimeNotIncreasing { count, .. }) if self.warned => *count += 1,
                _ => warnings.push(LogWarning::TimeNotIncreasing {
                    touch: touch.to_owned(),
                    row,
                    before_s,
                    now_s,
                    count: 1,
                }),
            }
            self.warned = true;
        }
        self.before_s = time_s;
    }
}
