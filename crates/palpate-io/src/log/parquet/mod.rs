//! Touches as Parquet: data sets of LeRobot, and tables with the column names of CSV.
//!
//! | what      | lists, as in LeRobot                                    | or a column per joint |
//! |-----------|---------------------------------------------------------|-----------------------|
//! | positions | `observation.state`                                     | as in CSV             |
//! | torques   | `observation.effort`, `.efforts`, `.torque`, `.torques` | as in CSV             |
//! | time, s   | `timestamp`                                             | as in CSV             |
//! | touch     | `episode_index`                                         | as in CSV             |
//!
//! A log is a file, a folder of files, or a data set with its files in `data/`, read in natural
//! order. An episode is a touch; without that column, each file is one. The joints of lists are
//! named by `meta/info.json`; without names, their order is assumed to be that of the robot. Only
//! the needed columns are read, a batch of rows at a time.

mod lerobot;
mod sizes;

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use ::parquet::errors::ParquetError;
use ::parquet::file::reader::{FileReader, SerializedFileReader};
use ::parquet::record::reader::RowIter;
use ::parquet::record::{Field, Row};
use ::parquet::schema::types::Type;
use palpate::Sample;

use super::MAX_JOINTS;
use super::columns::{Columns, Time};
use super::error::{LogError, TableError};
use super::event::{LogFormat, LoggedTorques};
use super::files::{FileDescription, TouchFile};
use super::options::LogOptions;
use crate::{input, panics};

const STATES: &[&str] = &["observation.state", "observation.position", "observation.positions"];
const EFFORTS: &[&str] =
    &["observation.effort", "observation.efforts", "observation.torque", "observation.torques"];
/// Largest length of the name of a touch, bytes.
const LONGEST_NAME: usize = 4096;
/// Example of a column map in the error message for missing or ambiguous columns.
const EXAMPLE: &str = ": columns = { q = [\"observation.state\"], tau = [\"observation.effort\"], \
                       time = \"timestamp\", touch = \"episode_index\" }";

/// One file being read.
pub(super) struct ParquetFile {
    path: PathBuf,
    header: Vec<String>,
    columns: Columns,
    /// Index in a row that is read of each column of the file; `None` for columns that are not read.
    in_row: Vec<Option<usize>>,
    reader: RowIter<'static>,
    rows: u64,
    row: u64,
    joints: Option<usize>,
    /// For lists: the joints that the data set names.
    named: Option<lerobot::Joints>,
}

impl TouchFile for ParquetFile {
    const FORMAT: LogFormat = LogFormat::Parquet;

    fn open(path: &Path, options: &LogOptions) -> Result<Self, LogError> {
        let mut file = input::open(path).map_err(|source| LogError::reading(path, source))?;
        let broken = |error| broken(path, &error);
        let reader = unbroken(path, || {
            sizes::check_footer(&mut file)?;
            SerializedFileReader::new(file.try_clone()?)
        })?;
        let metadata = reader.metadata().file_metadata();
        let (schema, rows) = (metadata.schema(), metadata.num_rows());
        let header: Vec<String> =
            schema.get_fields().iter().map(|field| field.name().to_owned()).collect();
        let columns = columns(&header, options)
            .map_err(|reason| TableError::columns(path, reason, &header, EXAMPLE))?;
        let named = match (&*columns.q, &*columns.tau) {
            (&[q], &[tau]) if columns.joint_names.is_none() && options.columns.is_none() => {
                lerobot::joints(path, &header[q], &header[tau])
            }
            _ => Ok(None),
        };
        let named = named.map_err(|reason| TableError::columns(path, reason, &header, EXAMPLE))?;
        let mut wanted: Vec<usize> = columns.used().collect();
        wanted.sort_unstable();
        wanted.dedup();
        let place = |column| wanted.iter().position(|&wanted| wanted == column);
        let in_row = (0..header.len()).map(place).collect();
        let fields = wanted.iter().map(|&column| Arc::clone(&schema.get_fields()[column]));
        let projection = Type::group_type_builder(schema.name())
            .with_fields(fields.collect())
            .build()
            .map_err(broken)?;
        if let Some(group) = unbroken(path, || too_large(&mut file, &reader, &wanted))? {
            return Err(TableError::TooLarge { path: path.to_owned(), group }.into());
        }
        let rows_of = || RowIter::from_file_into(Box::new(reader)).project(Some(projection));
        let reader = unbroken(path, rows_of)?;
        Ok(Self {
            path: path.to_owned(),
            header,
            columns,
            in_row,
            reader,
            rows: u64::try_from(rows).unwrap_or(0),
            row: 0,
            joints: None,
            named,
        })
    }

    fn describe(&self) -> FileDescription {
        let known = self.columns.describe(&self.path, &self.header);
        let continues_touches = known.names_touches;
        let named = self.named.as_ref().map(|joints| joints.names.clone());
        let known = FileDescription { joint_names: known.joint_names.or(named), ..known };
        FileDescription { samples: Some(self.rows), continues_touches, ..known }
    }

    fn next_row(&mut self) -> Result<Option<(Option<String>, Sample)>, LogError> {
        let Some(row) = unbroken(&self.path, || self.reader.next().transpose())? else {
            return match self.rows.saturating_sub(self.row) {
                0 => Ok(None),
                missing => {
                    let reason = format!("{missing} of its {} rows are missing", self.rows);
                    Err(TableError::NotParquet { path: self.path.clone(), reason }.into())
                }
            };
        };
        let mut q = self.numbers(&row, &self.columns.q)?;
        self.columns.turn_degrees(&mut q);
        let mut tau = self.numbers(&row, &self.columns.tau)?;
        if let Some(named) = &self.named {
            q = self.chosen(&q, &named.q, self.columns.q[0])?;
            tau = self.chosen(&tau, &named.tau, self.columns.tau[0])?;
        }
        let joints = *self.joints.get_or_insert(q.len());
        if q.len() != joints || tau.len() != joints || joints > MAX_JOINTS {
            let (found, torques) = (q.len(), tau.len());
            let reason =
                format!("{found} positions and {torques} torques; wanted {joints} of each");
            return Err(self.refused(&self.header[self.columns.tau[0]], reason).into());
        }
        let number = |place| -> Result<f64, TableError> {
            Ok(self.numbers(&row, &[place])?.first().copied().unwrap_or_default())
        };
        let mut time = self.columns.time.clone();
        let time_s = time.as_mut().map(|time| time.seconds(number)).transpose()?;
        self.columns.time = time;
        let touch = self.columns.touch.map(|place| self.touch(&row, place)).transpose()?;
        self.row += 1;
        Ok(Some((touch, Sample::new(time_s, q, tau))))
    }

    fn guessed_ticks_per_s(&self) -> Option<f64> {
        self.columns.guessed_ticks_per_s()
    }

    fn place(&self) -> String {
        format!("row {} (from 0)", self.row.saturating_sub(1))
    }
}

impl ParquetFile {
    fn field<'a>(&self, row: &'a Row, place: usize) -> Option<&'a Field> {
        let place = self.in_row[place]?;
        row.get_column_iter().nth(place).map(|(_, field)| field)
    }

    /// The numbers of some columns, each of which may contain a number or a list.
    fn numbers(&self, row: &Row, places: &[usize]) -> Result<Vec<f64>, TableError> {
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

    /// The elements of a list at some indices; `column` is for the error message.
    fn chosen(
        &self,
        list: &[f64],
        places: &[usize],
        column: usize,
    ) -> Result<Vec<f64>, TableError> {
        let chosen: Option<Vec<f64>> =
            places.iter().map(|&place| list.get(place).copied()).collect();
        chosen.ok_or_else(|| {
            let reason =
                format!("it holds {} numbers, fewer than the names in meta/info.json", list.len());
            self.refused(&self.header[column], reason)
        })
    }

    /// The name of a touch: a text, or the number of an episode.
    fn touch(&self, row: &Row, place: usize) -> Result<String, TableError> {
        match self.field(row, place) {
            Some(Field::Str(text)) if text.len() > LONGEST_NAME => {
                let reason = format!("the name of its touch has {} bytes", text.len());
                let wanted = format!("{reason}; wanted at most {LONGEST_NAME}");
                Err(self.refused(&self.header[place], wanted))
            }
            Some(Field::Str(text)) => Ok(text.clone()),
            Some(field) if number(field).is_some() => Ok(format!("episode_{field}")),
            _ => Err(self.refused(&self.header[place], "it does not name a touch".to_owned())),
        }
    }

    fn refused(&self, column: &str, reason: String) -> TableError {
        let (path, row) = (self.path.clone(), self.row);
        TableError::Value { path, row, column: column.to_owned(), reason }
    }
}

/// The first row group whose wanted columns exceed [`input::largest`] when uncompressed, if there is
/// one. The size of a column is the larger of its declared size and that of its largest page.
fn too_large(
    file: &mut File,
    reader: &SerializedFileReader<File>,
    wanted: &[usize],
) -> Result<Option<usize>, ParquetError> {
    let metadata = reader.metadata();
    let root = |column: usize| metadata.file_metadata().schema_descr().get_column_root_idx(column);
    for (number, group) in metadata.row_groups().iter().enumerate() {
        let columns = group.columns().iter().enumerate();
        let mut bytes = 0_u64;
        for (_, chunk) in columns.filter(|(column, _)| wanted.contains(&root(*column))) {
            let (start, length) = chunk.byte_range();
            let page = sizes::largest_page(file, start, length)?;
            let all = u64::try_from(chunk.uncompressed_size()).unwrap_or(0);
            bytes = bytes.saturating_add(all.max(page));
        }
        if bytes > input::largest() {
            return Ok(Some(number));
        }
    }
    Ok(None)
}

/// Runs `work` of the library and turns a panic, where sizes or pages contradict each other, into an error.
fn unbroken<T>(
    path: &Path,
    work: impl FnOnce() -> Result<T, ParquetError>,
) -> Result<T, TableError> {
    panics::caught(work)
        .unwrap_or_else(|reason| Err(ParquetError::General(reason)))
        .map_err(|error| broken(path, &error))
}

fn broken(path: &Path, error: &ParquetError) -> TableError {
    let (path, reason) = (path.to_owned(), error.to_string());
    match reason.rsplit_once("Disabled feature at compile time: ") {
        Some((_, codec)) => TableError::Compressed { path, codec: codec.to_owned() },
        None => TableError::NotParquet { path, reason },
    }
}

/// The columns in the options, those of LeRobot, or those with the names of CSV. The error is the end
/// of a message to the user.
fn columns(header: &[String], options: &LogOptions) -> Result<Columns, String> {
    let first =
        |names: &[&str]| names.iter().find_map(|name| header.iter().position(|held| held == name));
    let state = first(STATES).filter(|_| options.columns.is_none());
    match (state, first(EFFORTS)) {
        (Some(q), Some(tau)) => Ok(Columns {
            q: vec![q],
            tau: vec![tau],
            degrees: Vec::new(),
            joint_names: None,
            named_in_row: None,
            time: first(&["timestamp"])
                .map(|place| Time::at(place, None, header).in_unit(options.time_unit)),
            touch: first(&["episode_index"]),
            torques: LoggedTorques::Unknown,
        }),
        (Some(q), None) => Err(format!(
            "positions are in `{}`, but no column holds torques; its known names are {}",
            header[q],
            EFFORTS.join(", ")
        )),
        (None, _) => {
            let columns = Columns::find(header, options.columns.as_ref())?;
            if columns.named_in_row.is_some() {
                let remedy = "which are supported in CSV only: name the columns, in the order of the robot's joints";
                return Err(format!("the rows contain names of joints, {remedy}"));
            }
            columns.in_units(header, options)
        }
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
