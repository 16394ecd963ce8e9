//! Touches as Parquet: the data sets of LeRobot, and tables whose columns are called as in CSV.
//!
//! | what      | lists, as LeRobot has them                            | or a column a joint |
//! |-----------|-------------------------------------------------------|---------------------|
//! | positions | `observation.state`                                   | as in CSV           |
//! | torques   | `observation.effort`, `.efforts`, `.torque`, `.torques` | as in CSV           |
//! | time, s   | `timestamp`                                           | as in CSV           |
//! | touch     | `episode_index`                                       | as in CSV           |
//!
//! A log is a file, a folder of them, or a data set with its files in `data/`, read in natural
//! order. An episode is a touch; without that column, a file is. Lists name no joints: their order
//! is believed. Only the columns that are needed are read, a batch of rows at a time.

use std::collections::HashSet;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ::parquet::file::reader::{FileReader, SerializedFileReader};
use ::parquet::record::reader::RowIter;
use ::parquet::record::{Field, Row};
use ::parquet::schema::types::Type;

use super::csv::Columns;
use super::{
    Clock, Format, Log, LogDescription, LogError, LogEvent, LogOptions, LogWarning, LoggedTorques,
    MAX_JOINTS, Sample, natural,
};

const STATES: &[&str] = &["observation.state", "observation.position", "observation.positions"];
const EFFORTS: &[&str] =
    &["observation.effort", "observation.efforts", "observation.torque", "observation.torques"];

/// What can be wrong with a Parquet file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum ParquetError {
    /// A file that is not Parquet, or a broken one.
    #[error("`{path}` is no Parquet file, or a broken one: {reason}; copy it again")]
    Broken { path: PathBuf, reason: String },
    /// Columns that cannot be told apart.
    #[error(
        "`{path}`: {reason}. Its columns are {columns}. Name those to read in the settings of the \
         log: columns = {{ q = [\"observation.state\"], tau = [\"observation.effort\"], time = \
         \"timestamp\", touch = \"episode_index\" }}, the last two if there are any"
    )]
    Columns { path: PathBuf, reason: String, columns: String },
    /// A row that cannot be used.
    #[error("`{path}`, row {row} (from 0), column `{column}`: {reason}")]
    Row { path: PathBuf, row: u64, column: String, reason: String },
}

/// Whether a path is a Parquet file by its name, or a folder that holds such files.
pub(super) fn files_in(path: &Path) -> Vec<PathBuf> {
    let is_file = |path: &Path| {
        path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("parquet"))
            && path.is_file()
    };
    if is_file(path) {
        return vec![path.to_owned()];
    }
    let below = |folder: &Path| -> Vec<PathBuf> {
        let entries = folder.read_dir().into_iter().flatten().filter_map(Result::ok);
        let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
        paths.sort_by(|a, b| natural::compare(&a.to_string_lossy(), &b.to_string_lossy()));
        paths
    };
    let data = path.join("data");
    let folder = if data.is_dir() { &data } else { path };
    let mut files = Vec::new();
    for entry in below(folder) {
        if is_file(&entry) {
            files.push(entry);
        } else if entry.is_dir() {
            files.extend(below(&entry).into_iter().filter(|path| is_file(path)));
        }
    }
    files
}

/// Whether a file begins as Parquet does.
pub(super) fn is_parquet(path: &Path) -> bool {
    let mut magic = [0; 4];
    File::open(path).and_then(|mut file| file.read_exact(&mut magic)).is_ok() && magic == *b"PAR1"
}

/// A log of Parquet files.
pub(super) struct ParquetLog {
    description: LogDescription,
    options: LogOptions,
    /// Files to come, the last one first.
    ahead: Vec<PathBuf>,
    current: Option<Table>,
    touch: Option<String>,
    finished: HashSet<String>,
    waiting: Option<Sample>,
    row: u64,
    clock: Clock,
    warnings: Vec<LogWarning>,
}

impl ParquetLog {
    /// Checks the columns of all `files`, then stands before the first.
    pub(super) fn open(
        path: &Path,
        mut files: Vec<PathBuf>,
        options: &LogOptions,
    ) -> Result<Self, LogError> {
        let (mut samples, mut named) = (0, true);
        for file in &files {
            let table = Table::open(file, options)?;
            samples += table.rows;
            named &= table.places.touch.is_some();
        }
        let description = LogDescription {
            path: path.to_owned(),
            format: Format::Parquet,
            touches: (!named).then_some(files.len()),
            samples: Some(samples),
            joints: None,
            torques: LoggedTorques::Unsaid,
        };
        files.reverse();
        Ok(Self {
            description,
            options: options.clone(),
            ahead: files,
            current: None,
            touch: None,
            finished: HashSet::new(),
            waiting: None,
            row: 0,
            clock: Clock::default(),
            warnings: Vec::new(),
        })
    }

    /// The next event, or `None` at the end.
    fn advance(&mut self) -> Result<Option<LogEvent>, LogError> {
        if let Some(sample) = self.waiting.take() {
            return Ok(Some(self.noted(sample)));
        }
        loop {
            if let Some(table) = &mut self.current
                && let Some((touch, sample)) = table.next_sample()?
            {
                if self.touch.as_ref() == Some(&touch) {
                    return Ok(Some(self.noted(sample)));
                }
                if !self.finished.insert(touch.clone()) {
                    let reason = format!("it goes back to touch `{touch}`; sort the rows by it");
                    return Err(table.refused("episode_index", reason).into());
                }
                self.touch = Some(touch.clone());
                (self.row, self.clock, self.waiting) = (0, Clock::default(), Some(sample));
                let joint_names = table.places.names.clone();
                return Ok(Some(LogEvent::TouchStarts { name: touch, joint_names }));
            }
            let Some(path) = self.ahead.pop() else { break };
            self.current = Some(Table::open(&path, &self.options)?);
        }
        match self.touch {
            Some(_) => Ok(None),
            None => Err(LogError::Empty { path: self.description.path.clone() }),
        }
    }

    fn noted(&mut self, mut sample: Sample) -> LogEvent {
        self.options.angle_unit.into_rad(&mut sample.q);
        let touch = self.touch.as_deref().unwrap_or_default();
        self.clock.tick(sample.time_s, touch, self.row, &mut self.warnings);
        self.row += 1;
        LogEvent::Sample(sample)
    }
}

impl Iterator for ParquetLog {
    type Item = Result<LogEvent, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.current.is_none() && self.ahead.is_empty() && self.waiting.is_none() {
            return None;
        }
        let event = self.advance();
        if !matches!(event, Ok(Some(_))) {
            (self.current, self.waiting) = (None, None);
            self.ahead.clear();
        }
        event.transpose()
    }
}

impl Log for ParquetLog {
    fn describe(&self) -> LogDescription {
        self.description.clone()
    }

    fn warnings(&self) -> &[LogWarning] {
        &self.warnings
    }
}

/// Which columns are what, by their places in the file.
struct Places {
    q: Vec<usize>,
    tau: Vec<usize>,
    names: Option<Vec<String>>,
    time: Option<usize>,
    touch: Option<usize>,
}

/// One file being read.
struct Table {
    path: PathBuf,
    header: Vec<String>,
    places: Places,
    /// Where the columns of the file are in a row that is read; those left out are nowhere.
    in_row: Vec<Option<usize>>,
    reader: RowIter<'static>,
    rows: u64,
    row: u64,
    joints: Option<usize>,
}

impl Table {
    fn open(path: &Path, options: &LogOptions) -> Result<Self, LogError> {
        let file = File::open(path).map_err(|source| LogError::reading(path, source))?;
        let broken = |error: ::parquet::errors::ParquetError| ParquetError::Broken {
            path: path.to_owned(),
            reason: error.to_string(),
        };
        let reader = SerializedFileReader::new(file).map_err(broken)?;
        let metadata = reader.metadata().file_metadata();
        let (schema, rows) = (metadata.schema(), metadata.num_rows());
        let header: Vec<String> =
            schema.get_fields().iter().map(|field| field.name().to_owned()).collect();
        let places = Places::find(&header, options).map_err(|reason| ParquetError::Columns {
            path: path.to_owned(),
            reason,
            columns: header.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", "),
        })?;
        let mut wanted: Vec<usize> = places.all().collect();
        wanted.sort_unstable();
        wanted.dedup();
        let place = |column| wanted.iter().position(|&wanted| wanted == column);
        let in_row = (0..header.len()).map(place).collect();
        let fields = wanted.iter().map(|&column| Arc::clone(&schema.get_fields()[column]));
        let projection = Type::group_type_builder(schema.name())
            .with_fields(fields.collect())
            .build()
            .map_err(broken)?;
        let reader =
            RowIter::from_file_into(Box::new(reader)).project(Some(projection)).map_err(broken)?;
        Ok(Self {
            path: path.to_owned(),
            header,
            places,
            in_row,
            reader,
            rows: u64::try_from(rows).unwrap_or(0),
            row: 0,
            joints: None,
        })
    }

    /// The next row: the name of its touch, and its sample.
    fn next_sample(&mut self) -> Result<Option<(String, Sample)>, ParquetError> {
        let row = match self.reader.next() {
            None => return Ok(None),
            Some(Ok(row)) => row,
            Some(Err(error)) => {
                let (path, reason) = (self.path.clone(), error.to_string());
                return Err(ParquetError::Broken { path, reason });
            }
        };
        let q = self.numbers(&row, &self.places.q)?;
        let tau = self.numbers(&row, &self.places.tau)?;
        let joints = *self.joints.get_or_insert(q.len());
        if q.len() != joints || tau.len() != joints || joints > MAX_JOINTS {
            let (found, torques) = (q.len(), tau.len());
            let reason =
                format!("{found} positions and {torques} torques; wanted {joints} of each");
            return Err(self.refused(&self.header[self.places.tau[0]], reason));
        }
        let time = self.places.time.map(|place| self.numbers(&row, &[place])).transpose()?;
        let touch = match self.places.touch {
            Some(place) => self.name(&row, place)?,
            None => self.path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        };
        self.row += 1;
        let time_s = time.and_then(|time| time.first().copied());
        Ok(Some((touch, Sample::new(time_s, q, tau))))
    }

    fn field<'a>(&self, row: &'a Row, place: usize) -> Option<&'a Field> {
        let place = self.in_row[place]?;
        row.get_column_iter().nth(place).map(|(_, field)| field)
    }

    /// The numbers of some columns, each of which may hold a list.
    fn numbers(&self, row: &Row, places: &[usize]) -> Result<Vec<f64>, ParquetError> {
        let mut numbers = Vec::new();
        for &place in places {
            let elements = match self.field(row, place) {
                Some(Field::ListInternal(list)) => list.elements(),
                Some(field) => std::slice::from_ref(field),
                None => &[],
            };
            for element in elements {
                match number(element).filter(|number| number.is_finite()) {
                    Some(number) => numbers.push(number),
                    None => {
                        let reason = format!("it holds {element}; every number must be finite");
                        return Err(self.refused(&self.header[place], reason));
                    }
                }
            }
        }
        Ok(numbers)
    }

    /// The name of a touch: a text, or the number of an episode.
    fn name(&self, row: &Row, place: usize) -> Result<String, ParquetError> {
        match self.field(row, place) {
            Some(Field::Str(text)) => Ok(text.clone()),
            Some(field) if number(field).is_some() => Ok(format!("episode_{field}")),
            _ => Err(self.refused(&self.header[place], "it names no touch".to_owned())),
        }
    }

    fn refused(&self, column: &str, reason: String) -> ParquetError {
        let (path, row) = (self.path.clone(), self.row);
        ParquetError::Row { path, row, column: column.to_owned(), reason }
    }
}

impl Places {
    /// The columns that are named, those of LeRobot, or those that are called as in a table. An
    /// error is half a sentence for the user.
    fn find(header: &[String], options: &LogOptions) -> Result<Self, String> {
        let first = |names: &[&str]| {
            names.iter().find_map(|name| header.iter().position(|held| held == name))
        };
        let state = first(STATES).filter(|_| options.columns.is_none());
        match (state, first(EFFORTS)) {
            (Some(q), Some(tau)) => Ok(Self {
                q: vec![q],
                tau: vec![tau],
                names: None,
                time: first(&["timestamp"]),
                touch: first(&["episode_index"]),
            }),
            (Some(q), None) => Err(format!(
                "positions are in `{}`, and no column holds torques, of which {} are known",
                header[q],
                EFFORTS.join(", ")
            )),
            (None, _) => {
                let columns = Columns::find(header, options.columns.as_ref())?;
                let (q, tau, names) = (columns.q, columns.tau, columns.joint_names);
                Ok(Self { q, tau, names, time: columns.time, touch: columns.touch })
            }
        }
    }

    fn all(&self) -> impl Iterator<Item = usize> {
        self.q.iter().chain(&self.tau).chain(&self.time).chain(&self.touch).copied()
    }
}

/// A field as a number, if it is one.
fn number(field: &Field) -> Option<f64> {
    Some(match *field {
        Field::Byte(x) => x.into(),
        Field::Short(x) => x.into(),
        Field::Int(x) => x.into(),
        Field::Long(x) => x as f64,
        Field::UByte(x) => x.into(),
        Field::UShort(x) => x.into(),
        Field::UInt(x) => x.into(),
        Field::ULong(x) => x as f64,
        Field::Float16(x) => x.into(),
        Field::Float(x) => x.into(),
        Field::Double(x) => x,
        _ => return None,
    })
}
