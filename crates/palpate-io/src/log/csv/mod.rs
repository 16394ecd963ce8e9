//! Touches as tables of text: one row a sample, columns by name.
//!
//! A file is one touch, unless a column says which touch each row belongs to; a folder of files is
//! a touch each, in natural order. Comma, semicolon or tab between the cells, quotes, a byte-order
//! mark, Windows line ends and lines that begin with `#` are all understood; decimals have a point.
//! Which column is what: [`columns`]. Rows stream, and no line is believed to be longer than 1 MiB.

mod columns;
mod sniff;

use super::{
    Clock, Format, Log, LogDescription, LogError, LogEvent, LogOptions, LogWarning, LoggedTorques,
    Sample, natural,
};
use ::csv::{ByteRecord, Reader, ReaderBuilder, Terminator, Trim};
pub(super) use columns::Columns;
use sniff::{MAX_LINE_BYTES, sniff};
use std::collections::HashSet;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

pub use columns::CsvColumns;

/// What can be wrong with a table.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum CsvError {
    /// Not a table at all.
    #[error("`{path}` {reason}; wanted rows of numbers below a line of column names")]
    NotTable { path: PathBuf, reason: String },
    /// Columns that cannot be told apart.
    #[error(
        "`{path}`: {reason}. Its columns are {header}. Name those to read in the settings of the \
         log, for two joints: columns = {{ q = [\"a\", \"b\"], tau = [\"c\", \"d\"], time = \"t\", \
         touch = \"n\" }}, the last two if there are any"
    )]
    Columns { path: PathBuf, reason: String, header: String },
    /// A row that is longer or shorter than the header.
    #[error("`{path}` has {found} cells in line {line}; wanted {wanted} as in its header")]
    Row { path: PathBuf, line: u64, found: usize, wanted: usize },
    /// A cell that is no finite number.
    #[error(
        "`{path}` holds {found} in line {line}, column `{column}`; every number must be finite, \
         with a decimal point: correct the line or cut it out"
    )]
    Cell { path: PathBuf, line: u64, column: String, found: String },
    /// A touch in two pieces.
    #[error(
        "`{path}` goes back to touch `{touch}` in line {line}; sort the rows by touch and time"
    )]
    TouchResumes { path: PathBuf, line: u64, touch: String },
}

/// Whether a file is called like a table.
pub(super) fn is_table(path: &Path) -> bool {
    let ending = path.extension().map(|ending| ending.to_ascii_lowercase());
    ending.is_some_and(|ending| ending == "csv" || ending == "tsv") && path.is_file()
}

/// The tables of a folder in natural order; hidden files are left out.
pub(super) fn tables_in(folder: &Path) -> Result<Vec<PathBuf>, LogError> {
    let mut tables = Vec::new();
    for entry in folder.read_dir().map_err(|source| LogError::reading(folder, source))? {
        let entry = entry.map_err(|source| LogError::reading(folder, source))?;
        if !entry.file_name().to_string_lossy().starts_with('.') && is_table(&entry.path()) {
            tables.push(entry.path());
        }
    }
    tables.sort_by(|a, b| natural::compare(&a.to_string_lossy(), &b.to_string_lossy()));
    Ok(tables)
}

/// A log of tables.
#[derive(Debug)]
pub(super) struct CsvLog {
    description: LogDescription,
    options: LogOptions,
    /// Tables to come, the last one first.
    ahead: Vec<PathBuf>,
    current: Option<Table>,
    clock: Clock,
    warnings: Vec<LogWarning>,
}

impl CsvLog {
    /// Checks the headers of all `tables`, then stands before the first.
    pub(super) fn open(
        path: &Path,
        mut tables: Vec<PathBuf>,
        options: &LogOptions,
    ) -> Result<Self, LogError> {
        let (mut joints, mut touches) = (None, Some(tables.len()));
        for table in &tables {
            let table = Table::open(table, options)?;
            let wanted = *joints.get_or_insert(table.columns.q.len());
            if table.columns.q.len() != wanted {
                let first = tables[0].display();
                let reason = format!("`{first}` has {wanted} joints, this file another number");
                return Err(table.unclear(reason).into());
            }
            touches = touches.filter(|_| table.columns.touch.is_none());
        }
        let (path, format) = (path.to_owned(), Format::Csv);
        let torques = LoggedTorques::Unsaid;
        let description = LogDescription { path, format, touches, samples: None, joints, torques };
        tables.reverse();
        let (clock, warnings) = (Clock::default(), Vec::new());
        Ok(Self {
            description,
            options: options.clone(),
            ahead: tables,
            current: None,
            clock,
            warnings,
        })
    }

    /// The next event, or `None` at the end.
    fn advance(&mut self) -> Result<Option<LogEvent>, LogError> {
        loop {
            if let Some(table) = &mut self.current
                && let Some(event) = table.next_event()?
            {
                return Ok(Some(self.noted(event)));
            }
            let Some(path) = self.ahead.pop() else { return Ok(None) };
            let mut table = Table::open(&path, &self.options)?;
            table.is_one_of_many = self.description.path != path;
            self.current = Some(table);
        }
    }

    /// Keeps the clock and the unit of the angles.
    fn noted(&mut self, mut event: LogEvent) -> LogEvent {
        let Some(table) = &self.current else { return event };
        match &mut event {
            LogEvent::TouchStarts { .. } => self.clock = Clock::default(),
            LogEvent::Sample(sample) => {
                self.options.angle_unit.into_rad(&mut sample.q);
                let row = table.row - 1;
                self.clock.tick(sample.time_s, &table.touch, row, &mut self.warnings);
            }
        }
        event
    }
}

impl Iterator for CsvLog {
    type Item = Result<LogEvent, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        let event = self.advance();
        if !matches!(event, Ok(Some(_))) {
            self.current = None;
            self.ahead.clear();
        }
        event.transpose()
    }
}

impl Log for CsvLog {
    fn describe(&self) -> LogDescription {
        self.description.clone()
    }

    fn warnings(&self) -> &[LogWarning] {
        &self.warnings
    }
}

/// One file being read.
#[derive(Debug)]
struct Table {
    path: PathBuf,
    reader: Reader<Lines<File>>,
    header: Vec<String>,
    columns: Columns,
    /// Whether touches of other files may have the same names.
    is_one_of_many: bool,
    /// Name of the touch being read; empty before the first.
    touch: String,
    finished: HashSet<String>,
    /// A sample whose touch has just been announced.
    waiting: Option<Sample>,
    /// Samples of this touch so far.
    row: u64,
}

impl Table {
    /// Reads the header and finds the columns.
    fn open(path: &Path, options: &LogOptions) -> Result<Self, LogError> {
        let open = || File::open(path).map_err(|source| LogError::reading(path, source));
        let dialect = sniff(BufReader::new(open()?))
            .map_err(|source| LogError::reading(path, source))?
            .map_err(|reason| CsvError::NotTable {
                path: path.to_owned(),
                reason: reason.to_owned(),
            })?;
        let mut builder = ReaderBuilder::new();
        builder.delimiter(dialect.delimiter).comment(Some(b'#')).trim(Trim::All);
        builder.has_headers(false).flexible(true).terminator(Terminator::Any(b'\n'));
        let mut table = Self {
            path: path.to_owned(),
            reader: builder.from_reader(Lines { input: open()?, left: 0, last: b'\n' }),
            header: Vec::new(),
            columns: Columns { q: vec![], tau: vec![], joint_names: None, time: None, touch: None },
            is_one_of_many: false,
            touch: String::new(),
            finished: HashSet::new(),
            waiting: None,
            row: 0,
        };
        let first = match &dialect.commented_header {
            Some(header) => {
                builder.from_reader(header.as_bytes()).byte_records().next().transpose()
            }
            None => table.next_record().map(Ok)?,
        };
        let first = first.ok().flatten().unwrap_or_default();
        table.header = first.iter().map(text).collect();
        table.find_columns(options)?;
        Ok(table)
    }

    fn find_columns(&mut self, options: &LogOptions) -> Result<(), CsvError> {
        if self.header.iter().all(|name| name.parse::<f64>().is_ok()) {
            return Err(self.unclear("the first line holds numbers instead of names".to_owned()));
        }
        self.columns = Columns::find(&self.header, options.columns.as_ref())
            .map_err(|reason| self.unclear(reason))?;
        if let Some(place) = self.columns.wrong_unit(&self.header, options.angle_unit) {
            let (name, unit) = (&self.header[place], options.angle_unit);
            let reason = format!("column `{name}` contradicts the angle unit {unit:?}; change it");
            return Err(self.unclear(reason));
        }
        Ok(())
    }

    /// The next row that is not blank, or `None` at the end.
    fn next_record(&mut self) -> Result<Option<ByteRecord>, LogError> {
        let mut record = ByteRecord::new();
        loop {
            self.reader.get_mut().left = MAX_LINE_BYTES;
            match self.reader.read_byte_record(&mut record) {
                Ok(true) if record.len() == 1 && record[0].is_empty() => {}
                Ok(true) => return Ok(Some(record)),
                Ok(false) => return Ok(None),
                Err(error) => {
                    let path = self.path.clone();
                    return Err(LogError::Io { path, source: io::Error::from(error) });
                }
            }
        }
    }

    /// The line in which the row that was read last ends, counted from 1.
    fn line(&self) -> u64 {
        self.reader.position().line().saturating_sub(1)
    }

    fn next_event(&mut self) -> Result<Option<LogEvent>, LogError> {
        if let Some(sample) = self.waiting.take() {
            self.row += 1;
            return Ok(Some(LogEvent::Sample(sample)));
        }
        let Some(record) = self.next_record()? else {
            if self.touch.is_empty() {
                return Err(LogError::Empty { path: self.path.clone() });
            }
            return Ok(None);
        };
        let line = self.line();
        if record.len() != self.header.len() {
            let (found, wanted) = (record.len(), self.header.len());
            return Err(CsvError::Row { path: self.path.clone(), line, found, wanted }.into());
        }
        let sample = self.sample(&record, line)?;
        let touch = self.touch_of(&record);
        if touch == self.touch {
            self.row += 1;
            return Ok(Some(LogEvent::Sample(sample)));
        }
        if !self.finished.insert(touch.clone()) {
            return Err(CsvError::TouchResumes { path: self.path.clone(), line, touch }.into());
        }
        self.touch.clone_from(&touch);
        (self.row, self.waiting) = (0, Some(sample));
        let joint_names = self.columns.joint_names.clone();
        Ok(Some(LogEvent::TouchStarts { name: touch, joint_names }))
    }

    /// The cell that names the touch, or the file's name.
    fn touch_of(&self, record: &ByteRecord) -> String {
        let stem =
            self.path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
        match self.columns.touch.map(|place| text(&record[place])) {
            Some(cell) if self.is_one_of_many => format!("{stem}/{cell}"),
            Some(cell) if !cell.is_empty() => cell,
            _ => stem,
        }
    }

    fn sample(&self, record: &ByteRecord, line: u64) -> Result<Sample, CsvError> {
        let number = |&place: &usize| {
            let cell = std::str::from_utf8(&record[place]).ok();
            let number = cell.and_then(|cell| cell.parse::<f64>().ok());
            number.filter(|number| number.is_finite()).ok_or_else(|| {
                let cell = text(&record[place]);
                let found =
                    if cell.is_empty() { "nothing".to_owned() } else { format!("`{cell}`") };
                let column = self.header[place].clone();
                CsvError::Cell { path: self.path.clone(), line, column, found }
            })
        };
        let time_s = self.columns.time.as_ref().map(number).transpose()?;
        let q = self.columns.q.iter().map(number).collect::<Result<_, _>>()?;
        let tau = self.columns.tau.iter().map(number).collect::<Result<_, _>>()?;
        Ok(Sample::new(time_s, q, tau))
    }

    fn unclear(&self, reason: String) -> CsvError {
        let mut header: Vec<String> =
            self.header.iter().take(40).map(|name| format!("`{name}`")).collect();
        if self.header.len() > 40 {
            header.push(format!("{} more", self.header.len() - 40));
        }
        CsvError::Columns { path: self.path.clone(), reason, header: header.join(", ") }
    }
}

fn text(cell: &[u8]) -> String {
    String::from_utf8_lossy(cell).into_owned()
}

/// Hands on a file as whole lines, none of them longer than `left` bytes.
///
/// A quote left open must not swallow the file; and since a record's own position is that of the
/// blank lines before it, lines are counted at their ends, of which the last line needs one.
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
                _ => Err(io::Error::other("a row is longer than 1 MiB; is a quote left open?")),
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
