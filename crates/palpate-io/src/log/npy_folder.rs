//! Touches as folders of npy files, the layout of OpenVSF: `seq_0/angles.npy`, `torques.npy`.
//!
//! | file          | or a name like that of a CSV column      | shape      | unit  | needed |
//! |---------------|------------------------------------------|------------|-------|--------|
//! | `angles.npy`  | `q.npy`, `joint_positions.npy`, ...      | T x n      | rad   | yes    |
//! | `torques.npy` | `tau.npy`, `measured_torques.npy`, ...   | T x n      | N·m ¹ | yes    |
//! | `time.npy`    | `t.npy`, `timestamps_ns.npy`, ...        | T or T x 1 | s ²   | no     |
//!
//! ¹ If there is no such array, external torques (`external_torques.npy`), or else motor currents
//! (`actual_current.npy`), A.
//! ² Or another unit, by [`LogOptions::time_unit`].
//!
//! A log is one such folder or a folder of them, read in natural order. The files of a touch are
//! read in parallel, a block of rows at a time. Shapes and lengths of *all* touches are checked
//! when the log is opened, NaN and infinity when the rows are read.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

use palpate::Sample;

use super::MAX_JOINTS;
use super::columns::{POSITIONS, Spelling, TORQUES, Time};
use super::error::LogError;
use super::event::{LogFormat, LoggedTorques};
use super::files::{FileDescription, TouchFile};
use super::folder;
use super::options::LogOptions;
use crate::input;
use crate::npy::Rows;

/// Error message for a folder in which one of the two is missing.
const WANTED: &str = "a touch needs `angles.npy` and `torques.npy`";

/// Whether a folder holds a touch.
///
/// A folder with only one of `angles.npy` and `torques.npy` counts: opening it then names the
/// missing file.
pub(super) fn is_touch(folder: &Path) -> bool {
    folder.join("angles.npy").is_file()
        || folder.join("torques.npy").is_file()
        || Arrays::are_called_so(folder)
}

/// Files of a touch.
struct Arrays {
    angles: PathBuf,
    torques: PathBuf,
    kind: LoggedTorques,
    time: Option<(Time, PathBuf)>,
}

impl Arrays {
    /// The arrays with the names of OpenVSF; instead of a missing one, the only array with another
    /// known name, and as time the first such array.
    ///
    /// # Errors
    ///
    /// If there are two arrays with other names in place of one with the name of OpenVSF.
    fn of(folder: &Path) -> Result<Self, LogError> {
        let (arrays, names) = Self::named(folder);
        let called = |spelling: &Spelling| -> Vec<&PathBuf> {
            let named = arrays.iter().zip(&names);
            named.filter(|(_, name)| spelling.is_of_array(name)).map(|(path, _)| path).collect()
        };
        let or_only = |path: PathBuf, others: &[&PathBuf]| match others {
            [other] if !path.is_file() => Ok((*other).clone()),
            [first, second, ..] if !path.is_file() => {
                let name = |path: &Path| path.file_name().map(|name| name.display().to_string());
                let [first, second] = [first, second].map(|path| name(path).unwrap_or_default());
                let remedy = format!("`{first}` and `{second}` may be it: rename the right one");
                Err(LogError::Missing { path, remedy })
            }
            _ => Ok(path),
        };
        let own = folder.join("torques.npy");
        let others = TORQUES.iter().map(|(kind, spelling)| (*kind, called(spelling)));
        let mut others = others.filter(|(_, arrays)| !arrays.is_empty() && !own.is_file());
        let (kind, torques) = others.next().unwrap_or_default();
        let (clock, time) = (folder.join("time.npy"), Time::at(0, None, &["time".to_owned()]));
        let of_others = || {
            let time = Time::in_one(&names)?;
            let place = time.places().next()?;
            Some((time, arrays[place].clone()))
        };
        Ok(Self {
            angles: or_only(folder.join("angles.npy"), &called(&POSITIONS))?,
            torques: or_only(folder.join("torques.npy"), &torques)?,
            kind,
            time: if clock.is_file() { Some((time, clock)) } else { of_others() },
        })
    }

    /// The npy files of a folder, and their names without extension.
    fn named(folder: &Path) -> (Vec<PathBuf>, Vec<String>) {
        let listed = folder::listed(folder).unwrap_or_default();
        let is_array = |path: &PathBuf| folder::is_file_with(path, &["npy"]);
        let named = listed.into_iter().filter(is_array).filter_map(|path| {
            let name = path.file_stem()?.to_string_lossy().into_owned();
            Some((path, name))
        });
        named.unzip()
    }

    /// Whether a folder has arrays with known names of positions, and arrays with known names of
    /// torques.
    fn are_called_so(folder: &Path) -> bool {
        let (_, names) = Self::named(folder);
        let any = |spelling: &Spelling| names.iter().any(|name| spelling.is_of_array(name));
        any(&POSITIONS) && TORQUES.iter().any(|(_, spelling)| any(spelling))
    }
}

/// Name of a touch: the name of its folder, even if the path is `.`.
pub(super) fn name_of(folder: &Path) -> String {
    let named = folder.file_name().map(ToOwned::to_owned);
    let named = named.or_else(|| Some(folder.canonicalize().ok()?.file_name()?.to_owned()));
    named.map_or_else(|| "touch".to_owned(), |name| name.to_string_lossy().into_owned())
}

/// One touch, with its files open at the same row.
#[derive(Debug)]
pub(super) struct TouchFolder {
    name: String,
    angles: Table,
    torques: Table,
    kind: LoggedTorques,
    time: Option<(Time, Table)>,
}

impl TouchFile for TouchFolder {
    const FORMAT: LogFormat = LogFormat::NpyFolder;

    /// Opens the files of a touch and checks that their shapes agree.
    fn open(folder: &Path, options: &LogOptions) -> Result<Self, LogError> {
        let arrays = Arrays::of(folder)?;
        let angles = Table::open(arrays.angles)?;
        let torques = Table::open(arrays.torques)?;
        let frames = angles.rows.rows;
        let fits = |table: &Table| table.rows.rows == frames && table.rows.columns == 1;
        let time = arrays.time.map(|(time, path)| match path.ends_with("time.npy") {
            true => Table::open(path).map(|table| Some((time, table))),
            // An array with another name may not be the time: it is ignored if its shape does not
            // fit.
            false => Ok(Table::open(path).ok().filter(fits).map(|table| (time, table))),
        });
        let time = time.transpose()?.flatten();
        let time = time.map(|(time, table)| (time.in_unit(options.time_unit), table));

        angles.check_shape()?;
        torques.check_shape()?;
        if torques.rows.shape() != angles.rows.shape() {
            let (t, n) = (angles.rows.rows, angles.rows.columns);
            let turned = torques.rows.shape() == [n as u64, t];
            let remedy = if turned { "; it is transposed: save torques.T" } else { "" };
            let angles = angles.file_name();
            return Err(torques.misfit(format!("{t} x {n} as in `{angles}` beside it{remedy}")));
        }
        if let Some((_, time)) = time.as_ref().filter(|(_, time)| !fits(time)) {
            let angles = angles.file_name();
            return Err(time.misfit(format!("({frames},), one time for each row of `{angles}`")));
        }
        Ok(Self { name: name_of(folder), angles, torques, kind: arrays.kind, time })
    }

    fn describe(&self) -> FileDescription {
        let (joints, samples) = (Some(self.angles.rows.columns), Some(self.angles.rows.rows));
        let (name, torques) = (self.name.clone(), self.kind);
        FileDescription { name, torques, joints, samples, ..FileDescription::default() }
    }

    fn check_joints(&self, first: &Path, joints: usize) -> Result<(), LogError> {
        if self.angles.rows.columns == joints {
            return Ok(());
        }
        Err(self.angles.misfit(format!("T x {joints} as in touch `{}`", name_of(first))))
    }

    fn next_row(&mut self) -> Result<Option<(Option<String>, Sample)>, LogError> {
        let Some(q) = self.angles.next_row()? else { return Ok(None) };
        let Some(tau) = self.torques.next_row()? else { return Ok(None) };
        let time_s = match &mut self.time {
            Some((unit, time)) => {
                let row = time.next_row()?;
                let number = row.and_then(|row| row.first().copied());
                number.map(|number| unit.seconds(|_| Ok::<_, LogError>(number))).transpose()?
            }
            None => None,
        };
        Ok(Some((None, Sample::new(time_s, q, tau))))
    }

    fn guessed_ticks_per_s(&self) -> Option<f64> {
        self.time.as_ref().and_then(|(time, _)| time.guessed_ticks_per_s())
    }

    fn place(&self) -> String {
        format!("row {} (from 0)", self.angles.rows.read.saturating_sub(1))
    }
}

/// An npy file of a touch, with its path for error messages.
#[derive(Debug)]
pub(super) struct Table {
    path: PathBuf,
    rows: Rows<File>,
}

impl Table {
    pub(super) fn open(path: PathBuf) -> Result<Self, LogError> {
        let file = input::open(&path).map_err(|source| match source.kind() {
            io::ErrorKind::NotFound => {
                LogError::Missing { path: path.clone(), remedy: WANTED.to_owned() }
            }
            _ => LogError::reading(&path, source),
        })?;
        let rows = Rows::open(file);
        let rows = rows.map_err(|source| LogError::Npy { path: path.clone(), source })?;
        Ok(Self { path, rows })
    }

    /// Checks that a table of joints is T x n with T > 0 and 1 to [`MAX_JOINTS`] columns.
    pub(super) fn check_shape(&self) -> Result<(), LogError> {
        let shape = self.rows.shape();
        let remedy = match shape {
            [0, _] => return Err(LogError::Empty { path: self.path.clone() }),
            [_, n] if (1..=MAX_JOINTS as u64).contains(n) => return Ok(()),
            [n, _] if (1..=MAX_JOINTS as u64).contains(n) => "; it is transposed: save array.T",
            [_] => "; for a single joint save array.reshape(-1, 1)",
            _ => "",
        };
        Err(self.misfit(format!(
            "T x n, one row for each frame and one column for each joint (at most {MAX_JOINTS}){remedy}"
        )))
    }

    fn file_name(&self) -> String {
        self.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
    }

    fn misfit(&self, wanted: String) -> LogError {
        LogError::Shape { path: self.path.clone(), found: self.rows.shape().to_vec(), wanted }
    }

    /// The next row; an error if a number in it is not finite.
    pub(super) fn next_row(&mut self) -> Result<Option<Vec<f64>>, LogError> {
        let numbers = match self.rows.next_row() {
            None => return Ok(None),
            Some(Err(source)) => return Err(LogError::Npy { path: self.path.clone(), source }),
            Some(Ok(numbers)) => numbers.to_vec(),
        };
        match numbers.iter().position(|number| !number.is_finite()) {
            None => Ok(Some(numbers)),
            Some(column) => {
                let (path, row, found) = (self.path.clone(), self.rows.read - 1, numbers[column]);
                Err(LogError::NotFinite { path, row, column, found })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{AngleUnit, LogEvent, open};
    use super::*;
    use crate::npy::write_header;
    use std::fs;

    /// Writes a `rows.len()` x n array.
    fn save<const N: usize>(path: &Path, rows: &[[f64; N]]) {
        let mut bytes = Vec::new();
        write_header(&mut bytes, "<f8", &[rows.len(), N]).unwrap();
        bytes.extend(rows.iter().flat_map(|row| row.iter().flat_map(|x| x.to_le_bytes())));
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }

    /// Writes a touch whose angles and torques are the given rows.
    fn touch<const N: usize, const M: usize>(
        folder: &Path,
        angles: &[[f64; N]],
        torques: &[[f64; M]],
    ) {
        save(&folder.join("angles.npy"), angles);
        save(&folder.join("torques.npy"), torques);
    }

    fn read(path: &Path) -> Result<Vec<LogEvent>, LogError> {
        open(path, &LogOptions::default())?.collect()
    }

    fn complaint(path: &Path) -> String {
        read(path).unwrap_err().to_string()
    }

    const TWO: &[[f64; 2]] = &[[1.0, 2.0], [3.0, 4.0]];

    #[test]
    fn a_set_is_read_in_natural_order_and_other_folders_are_left_alone() {
        let set = tempfile::tempdir().unwrap();
        for name in ["seq_10", "seq_2"] {
            touch(&set.path().join(name), TWO, TWO);
        }
        save(&set.path().join("truth/seq_2_external.npy"), TWO);
        fs::write(set.path().join("meta.json"), "{}").unwrap();

        let events = read(set.path()).unwrap();

        let starts: Vec<_> = events
            .iter()
            .filter_map(|event| match event {
                LogEvent::TouchStarts { name, .. } => Some(name.as_str()),
                LogEvent::Sample(_) => None,
            })
            .collect();
        assert_eq!(starts, ["seq_2", "seq_10"]);
        let second = Sample::new(None, vec![3.0, 4.0], vec![3.0, 4.0]);
        assert_eq!(events[2], LogEvent::Sample(second));
        let description = open(set.path(), &LogOptions::default()).unwrap().describe();
        assert_eq!((description.touches, description.samples), (Some(2), Some(4)));
        assert_eq!(read(&set.path().join("seq_2")).unwrap(), events[..3]);
    }

    #[test]
    fn other_names_of_the_arrays_are_known_and_their_time_may_be_in_nanoseconds() {
        let set = tempfile::tempdir().unwrap();
        let path = |name: &str| set.path().join("push").join(name);
        save(&path("q.npy"), TWO);
        save(&path("q_d.npy"), &[[9.0; 2]; 2]);
        save(&path("dq.npy"), &[[9.0; 2]; 2]);
        save(&path("measured_torques.npy"), &[[5.0, 6.0], [7.0, 8.0]]);
        save(&path("timestamps_ns.npy"), &[[1.0e9], [2.5e9]]);
        let events = read(set.path()).unwrap();
        let second = Sample::new(Some(2.5), vec![3.0, 4.0], vec![7.0, 8.0]);
        assert_eq!((events.len(), &events[2]), (3, &LogEvent::Sample(second)));
        save(&path("T.npy"), &[[0.0; 3]; 7]);
        assert_eq!(read(set.path()).unwrap(), events);
        // The names of OpenVSF have priority; of two other names, neither is used.
        touch(&set.path().join("push"), &[[0.0; 2]; 2], &[[0.0; 2]; 2]);
        assert_eq!(read(set.path()).unwrap()[2].clone(), {
            LogEvent::Sample(Sample::new(Some(2.5), vec![0.0; 2], vec![0.0; 2]))
        });
        fs::remove_file(path("angles.npy")).unwrap();
        save(&path("joint_positions.npy"), TWO);
        let complaint = complaint(set.path());
        assert!(complaint.contains("angles.npy` does not exist"), "{complaint}");
        assert!(complaint.contains("`joint_positions.npy` and `q.npy`"), "{complaint}");
    }

    #[test]
    fn external_torques_and_currents_are_read_where_there_are_no_measured_torques() {
        let set = tempfile::tempdir().unwrap();
        let folder = set.path().join("push");
        let kind = || open(set.path(), &LogOptions::default()).unwrap().describe().torques;
        let tau = || match &read(set.path()).unwrap()[1] {
            LogEvent::Sample(sample) => sample.tau.clone(),
            LogEvent::TouchStarts { .. } => panic!("the second event is a sample"),
        };
        save(&folder.join("actual_q.npy"), TWO);
        save(&folder.join("target_q.npy"), &[[9.0; 2]; 2]);
        save(&folder.join("actual_current.npy"), &[[0.1, 0.2]; 2]);
        assert_eq!((kind(), tau()), (LoggedTorques::Currents, vec![0.1, 0.2]));
        save(&folder.join("external_torques.npy"), &[[0.3, 0.4]; 2]);
        assert_eq!((kind(), tau()), (LoggedTorques::External(None), vec![0.3, 0.4]));
        save(&folder.join("tau.npy"), &[[0.5, 0.6]; 2]);
        assert_eq!((kind(), tau()), (LoggedTorques::Unknown, vec![0.5, 0.6]));
        save(&folder.join("torques.npy"), &[[0.7, 0.8]; 2]);
        assert_eq!((kind(), tau()), (LoggedTorques::Unknown, vec![0.7, 0.8]));
    }

    #[test]
    fn degrees_become_radians() {
        let folder = tempfile::tempdir().unwrap();
        touch(folder.path(), &[[180.0]], &[[5.0]]);
        let options = LogOptions { angle_unit: Some(AngleUnit::Deg), ..Default::default() };
        let Some(Ok(LogEvent::Sample(sample))) = open(folder.path(), &options).unwrap().nth(1)
        else {
            panic!("one sample was written")
        };
        assert_eq!((sample.q, sample.tau), (vec![std::f64::consts::PI], vec![5.0]));
    }

    #[test]
    fn nan_is_located_and_ends_the_log() {
        let folder = tempfile::tempdir().unwrap();
        touch(folder.path(), TWO, &[[0.0, 0.0], [0.0, f64::NAN]]);
        let mut log = open(folder.path(), &LogOptions::default()).unwrap();
        assert!(log.next().unwrap().is_ok() && log.next().unwrap().is_ok());
        let error = log.next().unwrap().unwrap_err().to_string();
        assert!(error.contains("torques.npy") && error.contains("NaN"), "{error}");
        assert!(error.contains("row 1, column 1 (both counted from 0)"), "{error}");
        assert!(log.next().is_none());
    }

    #[test]
    fn shapes_that_disagree_are_refused_with_the_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        touch(path, TWO, &[[1.0, 2.0]]);
        assert!(complaint(path).contains("torques.npy") && complaint(path).contains("2 x 2"));

        touch(path, &[[0.0]; 3], &[[0.0, 0.0, 0.0]]);
        assert!(complaint(path).contains("transposed: save torques.T"));
        touch(path, &[[0.0; 400]; 7], &[[0.0; 400]; 7]);
        assert!(complaint(path).contains("[7, 400]") && complaint(path).contains("array.T"));

        touch(path, TWO, TWO);
        save(&path.join("time.npy"), &[[0.0]]);
        assert!(complaint(path).contains("time.npy") && complaint(path).contains("(2,)"));

        touch::<2, 2>(path, &[], &[]);
        assert!(complaint(path).contains("angles.npy") && complaint(path).contains("is empty"));
    }

    #[test]
    fn touches_must_agree_on_the_number_of_joints() {
        let set = tempfile::tempdir().unwrap();
        touch(&set.path().join("a"), TWO, TWO);
        touch(&set.path().join("b"), &[[0.0; 3]], &[[0.0; 3]]);
        let complaint = complaint(set.path());
        assert!(complaint.contains("T x 2 as in touch `a`"), "{complaint}");
    }

    #[test]
    fn the_error_names_what_is_missing() {
        let set = tempfile::tempdir().unwrap();
        assert!(complaint(&set.path().join("nowhere")).contains("does not exist"));
        assert!(complaint(set.path()).contains("it is empty"));
        fs::write(set.path().join("notes.md"), "").unwrap();
        assert!(complaint(set.path()).contains("it holds notes.md"));
        assert!(complaint(&set.path().join("notes.md")).contains("unknown format"));
        save(&set.path().join("seq_0/angles.npy"), TWO);
        assert!(complaint(set.path()).contains("torques.npy` does not exist"));
        fs::write(set.path().join("seq_0/torques.npy"), "not numbers").unwrap();
        assert!(complaint(set.path()).contains("is not an npy file"));
    }
}
