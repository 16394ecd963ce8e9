//! Touches as tables of text: one row per sample, columns by name.
//!
//! A file is one touch, unless a column says which touch each row belongs to. A folder of files is read in
//! natural order. Cells are separated by commas, semicolons, tabs or blanks; quotes, a byte-order mark, Windows
//! line ends and comments that begin with `#` or `%` are allowed; the decimal separator is a point.
//! [`super::columns`] decides which column is what. Rows stream, and a line may have at most 1 MiB.

mod sniff;

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

use ::csv::{ByteRecord, Reader, ReaderBuilder, Terminator, Trim};
use palpate::Sample;

use super::columns::{Columns, Time, date_s};
use super::error::{LogError, TableError};
use super::event::LogFormat;
use super::files::{FileDescription, TouchFile};
use super::folder;
use super::options::LogOptions;
use crate::input;
use sniff::{MAX_LINE_BYTES, sniff};

/// Example of a column map in the error message for missing or ambiguous columns.
const EXAMPLE: &str = ", for two joints: columns = { q = [\"a\", \"b\"], tau = [\"c\", \"d\"], time = \
                       \"t\", touch = \"n\" }";

const NO_HEADER: &str =
    "the first line holds numbers instead of names, so columns are called by their numbers, from 1";

/// Whether a file has the extension of a table.
pub(super) fn is_table(path: &Path) -> bool {
    folder::is_file_with(path, &["csv", "tsv"])
}

/// Whether a file that is given directly (not found in a folder) may be a table: programs also use these extensions.
pub(super) fn may_be_table(path: &Path) -> bool {
    folder::is_file_with(path, &["txt", "log", "dat"])
}

/// One file being read.
#[derive(Debug)]
pub(super) struct CsvFile {
    path: PathBuf,
    reader: Reader<Lines<File>>,
    delimiter: u8,
    header: Vec<String>,
    columns: Columns,
    /// The first row, if it was already read to learn its content.
    first: Option<ByteRecord>,
}

impl TouchFile for CsvFile {
    const FORMAT: LogFormat = LogFormat::Csv;

    /// Reads the header and finds the columns.
    fn open(path: &Path, options: &LogOptions) -> Result<Self, LogError> {
        let open = || input::open(path).map_err(|source| LogError::reading(path, source));
        let dialect = sniff(BufReader::new(open()?))
            .map_err(|source| LogError::reading(path, source))?
            .map_err(|reason| TableError::NotCsv {
                path: path.to_owned(),
                reason: reason.to_owned(),
            })?;
        let mut builder = ReaderBuilder::new();
        let delimiter = dialect.delimiter;
        builder.delimiter(delimiter).comment(Some(dialect.comment)).trim(Trim::All);
        builder.has_headers(false).flexible(true).terminator(Terminator::Any(b'\n'));
        let mut reader = builder.from_reader(Lines { input: open()?, left: 0, last: b'\n' });
        let first = match &dialect.commented_header {
            Some(header) => {
                let header = builder.from_reader(header.as_bytes()).byte_records().next();
                header.and_then(Result::ok).map(|header| without_runs(header, delimiter))
            }
            None => next_record(&mut reader, delimiter, path)?,
        };
        let first = first.unwrap_or_default();
        let mut header: Vec<String> = first.iter().map(text).collect();
        // Without a header, columns are named by their numbers, and the first line is a row.
        let is_row = holds_numbers(&header);
        if is_row {
            header = (1..=header.len()).map(|number| number.to_string()).collect();
        }
        let mut columns = match is_row && options.columns.is_none() {
            true => Err(NO_HEADER.to_owned()),
            false => columns(&header, options),
        }
        .map_err(|reason| TableError::columns(path, reason, &header, EXAMPLE))?;
        let mut first = is_row.then_some(first);
        if let Some(places) = &columns.named_in_row {
            first = next_record(&mut reader, delimiter, path)?;
            let whole = first.as_ref().filter(|row| row.len() == header.len());
            // A single cell without a list may name something else, not the joints.
            let is_list = |row: &&ByteRecord| places.len() > 1 || row[places[0]].starts_with(b"[");
            let names = whole.filter(is_list).map(|row| names_in(row, places));
            columns.joint_names = names.filter(|names| names.len() == columns.q.len());
            if columns.joint_names.is_none() {
                columns.named_in_row = None; // these are not the names of the joints
            }
        }
        // pandas writes its index as a column without a name.
        if columns.time.is_none() && options.columns.is_none() && header[0].is_empty() {
            if first.is_none() {
                first = next_record(&mut reader, delimiter, path)?;
            }
            let index = Time::at(0, None, &header).in_unit(options.time_unit);
            let is_date = |row: &ByteRecord| index.of_date(|place| cell(row, place)).is_some();
            columns.time = first.as_ref().is_some_and(is_date).then_some(index);
        }
        Ok(Self { path: path.to_owned(), reader, delimiter, header, columns, first })
    }

    fn describe(&self) -> FileDescription {
        FileDescription {
            joints: Some(self.columns.q.len()),
            ..self.columns.describe(&self.path, &self.header)
        }
    }

    fn check_joints(&self, first: &Path, joints: usize) -> Result<(), LogError> {
        if self.columns.q.len() == joints {
            return Ok(());
        }
        let (first, own) = (first.display(), self.columns.q.len());
        let reason = format!("`{first}` has {joints} joints, this file has {own}");
        Err(TableError::columns(&self.path, reason, &self.header, EXAMPLE).into())
    }

    fn next_row(&mut self) -> Result<Option<(Option<String>, Sample)>, LogError> {
        let next = match self.first.take() {
            Some(first) => Some(first),
            None => next_record(&mut self.reader, self.delimiter, &self.path)?,
        };
        let Some(record) = next else { return Ok(None) };
        if record.len() != self.header.len() {
            let (path, line) = (self.path.clone(), self.line());
            let (found, wanted) = (record.len(), self.header.len());
            return Err(TableError::Row { path, line, found, wanted }.into());
        }
        let named = self.columns.named_in_row.as_ref().map(|places| names_in(&record, places));
        if let (Some(found), Some(wanted)) = (named, &self.columns.joint_names)
            && found != *wanted
        {
            let (path, line) = (self.path.clone(), self.line());
            let (found, wanted) = (found.join(", "), wanted.join(", "));
            return Err(TableError::OtherJoints { path, line, found, wanted }.into());
        }
        let touch = self.columns.touch.map(|place| text(&record[place]));
        Ok(Some((touch, self.sample(&record)?)))
    }

    fn guessed_ticks_per_s(&self) -> Option<f64> {
        self.columns.guessed_ticks_per_s()
    }

    fn place(&self) -> String {
        format!("line {}", self.line())
    }
}

/// Whether all cells of the first line are numbers or dates, so that it is no header. The numbers 0, 1, 2, ... are a
/// header: pandas writes them for columns without names.
fn holds_numbers(line: &[String]) -> bool {
    let counted = line.iter().enumerate().all(|(at, name)| *name == at.to_string());
    let is_value = |name: &String| name.parse::<f64>().is_ok() || date_s(name).is_some();
    !counted && line.iter().all(is_value)
}

/// Finds the columns in a header. The error is the end of a message to the user.
fn columns(header: &[String], options: &LogOptions) -> Result<Columns, String> {
    let columns = match options.planned && options.columns.is_none() {
        true => Columns::find_planned(header)?,
        false => Columns::find(header, options.columns.as_ref())?,
    };
    columns.in_units(header, options)
}

/// The next row that is not blank, or `None` at the end.
fn next_record(
    reader: &mut Reader<Lines<File>>,
    delimiter: u8,
    path: &Path,
) -> Result<Option<ByteRecord>, LogError> {
    let mut record = ByteRecord::new();
    loop {
        reader.get_mut().left = MAX_LINE_BYTES;
        match reader.read_byte_record(&mut record) {
            Ok(true) if record.len() == 1 && record[0].is_empty() => {}
            Ok(more) => return Ok(more.then(|| without_runs(record, delimiter))),
            Err(error) => {
                return Err(LogError::Io { path: path.to_owned(), source: io::Error::from(error) });
            }
        }
    }
}

/// The names of the joints in a row: one per cell, or a list in one cell, such as `['elbow', 'wrist']`.
fn names_in(row: &ByteRecord, places: &[usize]) -> Vec<String> {
    let cells: Vec<String> = places.iter().map(|&place| text(&row[place])).collect();
    match &cells[..] {
        [list] if list.starts_with('[') => {
            let names = list.trim_matches(['[', ']']).split(',');
            names.map(|name| name.trim().trim_matches(['\'', '"']).to_owned()).collect()
        }
        _ => cells,
    }
}

/// Removes empty cells if the delimiter is a blank: programs align columns with several blanks.
fn without_runs(record: ByteRecord, delimiter: u8) -> ByteRecord {
    match delimiter {
        b' ' => record.iter().filter(|cell| !cell.is_empty()).collect(),
        _ => record,
    }
}

impl CsvFile {
    /// The line in which the row that was read last ends, counted from 1.
    fn line(&self) -> u64 {
        self.reader.position().line().saturating_sub(1)
    }

    fn sample(&mut self, record: &ByteRecord) -> Result<Sample, TableError> {
        let number = |place: usize| {
            let cell = std::str::from_utf8(&record[place]).ok();
            let number = cell.and_then(|cell| cell.parse::<f64>().ok());
            number.filter(|number| number.is_finite()).ok_or_else(|| {
                let cell = text(&record[place]);
                let found =
                    if cell.is_empty() { "nothing".to_owned() } else { format!("`{cell}`") };
                let (path, line, column) =
                    (self.path.clone(), self.line(), self.header[place].clone());
                TableError::Cell { path, line, column, found }
            })
        };
        let numbers = |places: &[usize]| -> Result<Vec<f64>, TableError> {
            places.iter().copied().map(number).collect()
        };
        let mut time = self.columns.time.clone();
        let seconds = |time: &mut Time| match time.of_date(|place| cell(record, place)) {
            Some(time_s) => Ok(time_s),
            None => time.seconds(number),
        };
        let time_s = time.as_mut().map(seconds).transpose()?;
        let mut q = numbers(&self.columns.q)?;
        self.columns.turn_degrees(&mut q);
        let tau = match self.columns.tau.is_empty() {
            true => vec![0.0; q.len()],
            false => numbers(&self.columns.tau)?,
        };
        self.columns.time = time; // the first row may have decided its unit
        Ok(Sample::new(time_s, q, tau))
    }
}

/// The text of a cell; empty if it is not UTF-8.
fn cell(row: &ByteRecord, place: usize) -> &str {
    std::str::from_utf8(&row[place]).unwrap_or_default()
}

fn text(cell: &[u8]) -> String {
    String::from_utf8_lossy(cell).into_owned()
}

/// Reads a file, with at most `left` bytes until `left` is set again, and adds a missing line end at the end of the
/// file.
///
/// The limit stops a row whose quote is never closed. The line end is needed because lines are counted at their ends:
/// the position of a record itself includes the blank lines before it.
#[derive(Debug)]
struct Lines<R> {
    input: R,
    left: u64,
    last: u8,
}

impl<R: Read> Read for Lines<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let room = into.len().min(usize::try_from(self.left).unwrap_or(usize::MAX));
        if room == 0 {
            return match into.len() {
                0 => Ok(0),
                _ => Err(io::Error::other(
                    "a row is longer than 1 MiB; is a closing quotation mark missing?",
                )),
            };
        }
        let mut read = self.input.read(&mut into[..room])?;
        if read == 0 && self.last != b'\n' {
            into[0] = b'\n';
            read = 1;
        }
        self.last = if read > 0 { into[read - 1] } else { self.last };
        self.left -= read as u64;
        Ok(read)
    }
}
