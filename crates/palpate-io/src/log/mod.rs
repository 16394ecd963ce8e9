//! Logs: what a robot recorded while it touched an object, as a stream of events.
//!
//! A log is read from its beginning to its end, and at most its first samples are held in memory, so that a file of
//! any length, a bag and a running robot give the same stream: a touch starts, its samples follow,
//! the next touch starts. A touch ends where the next one starts or the log ends.
//!
//! | layout                                       | module         |
//! |----------------------------------------------|----------------|
//! | folder with `angles.npy`, `torques.npy`      | `npy_folder`   |
//! | folder of such folders (also OpenVSF's)      | `npy_folder`   |
//! | `.csv`, or a folder of them                  | `csv`          |
//! | bag of ROS 2: `.mcap`, `.db3`, their folder  | `bag`          |
//! | `.parquet`, or a data set of LeRobot         | `parquet`      |
//!
//! | common to several layouts                              | module    |
//! |--------------------------------------------------------|-----------|
//! | unit of angles, clock, touches split at gaps in time   | `reader`  |
//! | several files that form one log                        | `files`   |
//! | recognition of the columns of a table                  | `columns` |
//! | unique names of touches                                | `names`   |
//! | unit of times that a log does not name                 | `clock`   |
//!
//! Torques are returned as logged: gravity and bias are not removed here. Only [`external_truth`]
//! reads the folder `truth/` beside the touches; a log never does.

mod bag;
mod clock;
mod columns;
mod csv;
mod error;
mod event;
mod files;
mod folder;
mod joints;
mod names;
mod npy_folder;
mod options;
#[cfg(feature = "formats")]
mod parquet;
mod reader;
mod truth;
pub mod write;

use std::path::{Path, PathBuf};

use bag::BagLog;
use csv::CsvFile;
use files::TouchFiles;
use npy_folder::TouchFolder;
#[cfg(feature = "formats")]
use parquet::ParquetFile;
use reader::{Reader, Source};

pub use bag::write as bag_write;
pub use clock::{ClockEvidence, OddClock};
pub use error::{BagError, LogError, TableError};
pub use event::{Log, LogDescription, LogEvent, LogFormat, LogWarning, LoggedTorques};
pub use joints::{JointNameError, reorder, unmatched};
pub use options::{AngleUnit, CsvColumns, LogOptions, TimeUnit};
pub use palpate::Sample;
pub use truth::{external_truth, is_simulated};

/// Largest number of joints; a wider array is refused as transposed or as something else.
const MAX_JOINTS: usize = 64;

/// Opens a log, whatever its format.
///
/// Headers and lengths of every file are checked before the first event, so that most defects are
/// found before any work is done. If a folder contains touches as npy, they are read, and tables
/// beside them are ignored.
///
/// # Errors
///
/// [`LogError`], whose message names the file and the remedy.
pub fn open(path: &Path, options: &LogOptions) -> Result<Box<dyn Log>, LogError> {
    Ok(Box::new(Reader::new(source(path, options)?, options)))
}

/// Opens a log in the format that is found, before the processing of `reader`.
fn source(path: &Path, options: &LogOptions) -> Result<Box<dyn Source>, LogError> {
    let failed = |source| LogError::reading(path, source);
    let is_folder = path.metadata().map_err(failed)?.is_dir();
    // A file or a single touch is read by itself; of any other folder, its direct entries.
    let is_one = !is_folder || npy_folder::is_touch(path);
    let entries =
        if is_one { vec![path.to_owned()] } else { folder::listed(path).map_err(failed)? };
    let of_kind = |is_kind: fn(&Path) -> bool| -> Vec<PathBuf> {
        entries.iter().filter(|entry| is_kind(entry)).cloned().collect()
    };

    let touches = of_kind(npy_folder::is_touch);
    if !touches.is_empty() {
        return Ok(Box::new(TouchFiles::<TouchFolder>::open(path, touches, options)?));
    }
    let tables = of_kind(csv::is_table);
    if !tables.is_empty() {
        return Ok(Box::new(TouchFiles::<CsvFile>::open(path, tables, options)?));
    }
    if bag::is_bag(path) {
        return Ok(Box::new(BagLog::open(path, options)?));
    }
    let files = if is_folder { folder::parquet_in(path) } else { of_kind(folder::is_parquet) };
    if !files.is_empty() {
        #[cfg(feature = "formats")]
        return Ok(Box::new(TouchFiles::<ParquetFile>::open(path, files, options)?));
        #[cfg(not(feature = "formats"))]
        return Err(TableError::NotBuilt { path: path.to_owned() }.into());
    }
    let texts = if is_folder { Vec::new() } else { of_kind(csv::may_be_table) };
    if !texts.is_empty() {
        return Ok(Box::new(TouchFiles::<CsvFile>::open(path, texts, options)?));
    }
    let found =
        if is_folder { contents(&entries) } else { "it is a file of an unknown format".to_owned() };
    Err(LogError::NoTouch { path: path.to_owned(), found, wanted: WANTED })
}

/// The supported kinds of logs, for an error message.
const WANTED: &str = "a folder with `angles.npy` and `torques.npy`, a folder of such folders, \
                      a .csv file or a folder of .csv files, a bag of ROS 2 (.mcap, .db3 or their \
                      folder), Parquet (.parquet or a folder of them)";

/// Describes the entries of a folder without touches, for an error message.
fn contents(entries: &[PathBuf]) -> String {
    let names: Vec<String> = entries.iter().map(|entry| npy_folder::name_of(entry)).collect();
    match names.as_slice() {
        [] => "it is empty".to_owned(),
        names if names.len() > 8 => {
            format!("it holds {} and {} more", names[..8].join(", "), names.len() - 8)
        }
        names => format!("it holds {}", names.join(", ")),
    }
}
