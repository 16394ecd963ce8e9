//! A log of several files with one or more touches each: the part that is common to its formats.

use std::collections::{HashSet, VecDeque};
use std::path::{Path, PathBuf};

use palpate::Sample;

use super::error::{LogError, TableError};
use super::event::{LogDescription, LogEvent, LogFormat, LogWarning, LoggedTorques};
use super::options::{CsvColumns, LogOptions};
use super::reader::Source;

/// One file (or folder of arrays) that is read row by row.
pub(super) trait TouchFile: Sized + Send {
    /// Format, for the description of the log.
    const FORMAT: LogFormat;

    /// Opens the file before its first row, and checks everything that can be checked before
    /// reading.
    fn open(path: &Path, options: &LogOptions) -> Result<Self, LogError>;

    /// Description of the file, available before its rows are read.
    fn describe(&self) -> FileDescription;

    /// Refuses a file whose number of joints differs from that of the first file, if known before
    /// reading.
    fn check_joints(&self, _first: &Path, _joints: usize) -> Result<(), LogError> {
        Ok(())
    }

    /// The next row: the name of its touch, if the file has a touch column, and its sample.
    fn next_row(&mut self) -> Result<Option<(Option<String>, Sample)>, LogError>;

    /// Ticks per second of the times, if their unit was guessed from the size of the first one that was read.
    fn guessed_ticks_per_s(&self) -> Option<f64>;

    /// Position in the file of the row that was read last, for an error message.
    fn place(&self) -> String;
}

/// Description of a file, available before its rows are read.
#[derive(Default)]
pub(super) struct FileDescription {
    /// Name of the touch if there is no touch column.
    pub(super) name: String,
    /// Kind of its torques.
    pub(super) torques: LoggedTorques,
    /// Number of joints.
    pub(super) joints: Option<usize>,
    /// Names of the joints, in the order of the samples.
    pub(super) joint_names: Option<Vec<String>>,
    /// Number of samples.
    pub(super) samples: Option<u64>,
    /// The columns that are read, if it is a table.
    pub(super) columns: Option<CsvColumns>,
    /// Whether it has a touch column.
    pub(super) names_touches: bool,
    /// Whether a touch of the same name may continue from the previous file.
    pub(super) continues_touches: bool,
}

/// A log of files of one format.
pub(super) struct TouchFiles<F> {
    description: LogDescription,
    options: LogOptions,
    /// Files that are not read yet, in reverse order.
    ahead: Vec<PathBuf>,
    current: Option<(PathBuf, F, FileDescription)>,
    /// Name of the current touch.
    touch: Option<String>,
    /// Number of rows in which the touch column is empty.
    between: u64,
    /// Whether the current file has a row whose touch column is empty.
    has_rows: bool,
    /// Names of the touches that have begun; the same touch must not begin twice.
    begun: HashSet<String>,
}

impl<F: TouchFile> TouchFiles<F> {
    /// Opens all `files` once to check and compare them; reading then begins with the first.
    pub(super) fn open(
        path: &Path,
        mut files: Vec<PathBuf>,
        options: &LogOptions,
    ) -> Result<Self, LogError> {
        let (mut touches, mut samples, mut joints) = (Some(files.len()), Some(0), None);
        let (mut torques, mut columns) = (None, None);
        for path in &files {
            let file = F::open(path, options)?;
            let known = file.describe();
            touches = touches.filter(|_| !known.names_touches);
            samples = samples.zip(known.samples).map(|(sum, more)| sum + more);
            joints = joints.or(known.joints);
            columns = columns.or(known.columns);
            if *torques.get_or_insert(known.torques) != known.torques {
                return Err(TableError::CurrentsAndTorques { path: path.clone() }.into());
            }
            joints.map_or(Ok(()), |joints| file.check_joints(&files[0], joints))?;
        }
        let (path, format) = (path.to_owned(), F::FORMAT);
        let torques = torques.unwrap_or_default();
        let angle_unit = columns.as_ref().and_then(CsvColumns::angle_unit);
        let description =
            LogDescription { path, format, touches, samples, joints, torques, angle_unit, columns };
        files.reverse();
        let (options, begun) = (options.clone(), HashSet::new());
        let (ahead, current, touch) = (files, None, None);
        Ok(Self { description, options, ahead, current, touch, between: 0, has_rows: false, begun })
    }

    /// Opens the next file; false at the end of the log.
    fn next_file(&mut self) -> Result<bool, LogError> {
        self.current = None;
        let Some(path) = self.ahead.pop() else { return Ok(false) };
        let file = F::open(&path, &self.options)?;
        let known = file.describe();
        if !known.continues_touches {
            self.touch = None;
            self.begun.clear();
        }
        self.current = Some((path, file, known));
        self.has_rows = false;
        Ok(true)
    }
}

impl<F: TouchFile> Source for TouchFiles<F> {
    fn describe(&self) -> LogDescription {
        self.description.clone()
    }

    fn guessed_ticks_per_s(&self) -> Option<f64> {
        self.current.as_ref().and_then(|(_, file, _)| file.guessed_ticks_per_s())
    }

    fn read_on(
        &mut self,
        events: &mut VecDeque<LogEvent>,
        warnings: &mut Vec<LogWarning>,
    ) -> Result<(), LogError> {
        while self.current.is_some() || self.next_file()? {
            let Some((path, file, known)) = &mut self.current else { break };
            let Some((touch, sample)) = file.next_row()? else {
                let may_be_empty = known.continues_touches && !self.ahead.is_empty();
                if self.touch.is_none() && !may_be_empty {
                    let (path, is_empty) = (path.clone(), !self.has_rows);
                    return Err(match is_empty {
                        true => LogError::Empty { path },
                        false => TableError::NoTouch { path }.into(),
                    });
                }
                self.current = None;
                continue;
            };
            if touch.as_ref().is_some_and(String::is_empty) {
                self.between += 1;
                self.has_rows = true;
                warnings.retain(|warning| !matches!(warning, LogWarning::BetweenTouches { .. }));
                warnings.push(LogWarning::BetweenTouches { rows: self.between });
                continue;
            }
            let name = match touch {
                // Prefixed by the file: touches of different files may have the same names.
                Some(touch) if !known.continues_touches && self.description.path != *path => {
                    format!("{}/{touch}", known.name)
                }
                Some(touch) => touch,
                None => known.name.clone(),
            };
            if self.touch.as_ref() != Some(&name) {
                if !self.begun.insert(name.clone()) {
                    let (path, place, touch) = (path.clone(), file.place(), name);
                    return Err(TableError::TouchResumes { path, place, touch }.into());
                }
                self.touch = Some(name.clone());
                let joint_names = known.joint_names.clone();
                events.push_back(LogEvent::TouchStarts { name, joint_names });
            }
            events.push_back(LogEvent::Sample(sample));
            return Ok(());
        }
        Ok(())
    }
}
