//! Logs, and the touches in them.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyUntypedArrayMethods};
use palpate::Sample;
use palpate_work::WorkError;
use palpate_work::settings::Settings;
use palpate_work::settings::sections::LogSettings;
use palpate_work::touches::{RecordedTouch, Touches};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict, PySequence, PyString, PyTuple};
use serde_json::json;

use crate::array::{copied, flat, row, rows, table_of};
use crate::data;
use crate::error::Result;

/// Name of touches in memory, for error messages.
const HELD: &str = "touches";

/// Touches in files, read as a stream: iterating yields one `Touch` after another.
///
/// `open_log` returns it. Only the current touch is in memory; each `for` begins with the first.
#[pyclass(frozen, module = "palpate")]
#[derive(Clone)]
pub(crate) struct Log {
    /// Paths of the log.
    #[pyo3(get)]
    paths: Vec<PathBuf>,
    settings: LogSettings,
}

/// One touch: an approach, a push and a retreat, T frames.
///
/// `q` are joint positions (T, n_joints) rad, `tau` joint torques as logged (T, n_joints) N·m,
/// `time` (T,) s. `joint_names` are the joints of the columns; in the robot's order if left out.
#[pyclass(frozen, get_all, module = "palpate")]
pub(crate) struct Touch {
    /// Name of the touch.
    name: String,
    /// Joint positions, (T, n_joints), rad (m where prismatic).
    q: Py<PyArray2<f64>>,
    /// Joint torques as logged, (T, n_joints), N·m.
    tau: Py<PyArray2<f64>>,
    /// Time by the log's clock, (T,), s; None if the log has no clock.
    time: Option<Py<PyArray1<f64>>>,
    /// Names of the joints in the order of the columns; None if the log does not contain them.
    joint_names: Option<Vec<String>>,
}

/// The touches of a log, one after another.
#[pyclass(frozen, module = "palpate")]
pub(crate) struct TouchIterator {
    touches: Mutex<Touches>,
}

/// A source of touches.
pub(crate) enum Source {
    /// Paths of a log, and its settings for reading.
    Log(Vec<PathBuf>, LogSettings),
    /// A touch in memory.
    Touch(RecordedTouch),
}

/// Opens one or more logs, which are read as one.
///
/// A log is a folder of one touch (angles.npy, torques.npy), a folder of such folders, a .csv file
/// or a folder of them, a bag of ROS 2 (MCAP, SQLite) or Parquet. `options` are the keys of
/// `palpate.settings.LogSettings`; splitting at pauses (`split_idle`) needs a robot, and is done by
/// the function that uses the log.
///
/// Raises LogError, which names the file and the remedy.
#[pyfunction]
#[pyo3(signature = (path, **options))]
pub(crate) fn open_log(
    path: &Bound<'_, PyAny>,
    options: Option<&Bound<'_, PyDict>>,
) -> Result<Log> {
    let settings = crate::settings::section("log", options)?.log;
    let mut paths = Vec::new();
    for source in sources(path)? {
        match source {
            Source::Log(more, _) => paths.extend(more),
            Source::Touch(_) => {
                let wanted = "wanted a path, or a list of paths";
                return Err(PyTypeError::new_err(format!("`path` holds a Touch; {wanted}")).into());
            }
        }
    }
    let log = Log { paths, settings };
    log.touches(path.py())?; // reports most defects now rather than later
    Ok(log)
}

impl Log {
    fn touches(&self, py: Python<'_>) -> Result<Touches> {
        Ok(py.detach(|| Touches::open(&self.paths, &self.settings.options()))?)
    }
}

/// The sources in an argument: a path, a [`Log`], a [`Touch`], or several of them.
pub(crate) fn sources(any: &Bound<'_, PyAny>) -> PyResult<Vec<Source>> {
    nested_sources(any, 0)
}

fn nested_sources(any: &Bound<'_, PyAny>, depth: usize) -> PyResult<Vec<Source>> {
    data::check_depth(depth, "a list of logs")?;
    let py = any.py();
    if let Ok(log) = any.cast::<Log>() {
        let Log { paths, settings } = log.get().clone();
        return Ok(vec![Source::Log(paths, settings)]);
    }
    if let Ok(touch) = any.cast::<Touch>() {
        return Ok(vec![Source::Touch(touch.get().recorded(py))]);
    }
    if any.is_instance_of::<PyString>() || any.hasattr("__fspath__")? {
        return Ok(vec![Source::Log(vec![any.extract()?], LogSettings::default())]);
    }
    let Ok(several) = any.cast::<PySequence>() else {
        return Err(PyTypeError::new_err(format!(
            "found {}; wanted the path of a log, a Log, a Touch, or a list of them",
            any.get_type().name()?
        )));
    };
    let mut all = Vec::new();
    for one in several.try_iter()? {
        all.extend(nested_sources(&one?, depth + 1)?);
    }
    if all.is_empty() {
        return Err(PyValueError::new_err("an empty list of logs; wanted at least one"));
    }
    Ok(all)
}

/// Opens sources as one log; the options of a [`Log`] override `settings`.
pub(crate) fn opened(sources: Vec<Source>, settings: &LogSettings) -> Result<Touches, WorkError> {
    let mut all = Touches::default();
    for source in sources {
        all = all.then(match source {
            Source::Touch(touch) => Touches::in_memory(HELD, vec![touch]),
            Source::Log(paths, own) => {
                let settings = Settings::from(own).over(settings.clone().into());
                Touches::open(&paths, &settings.log.options())?
            }
        });
    }
    Ok(all)
}

#[pymethods]
impl Log {
    fn __iter__(&self, py: Python<'_>) -> Result<TouchIterator> {
        Ok(TouchIterator { touches: Mutex::new(self.touches(py)?) })
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, ())> {
        let options = data::python(py, &data::given(json!(self.settings)))?;
        let open = py.import("palpate")?.getattr("open_log")?;
        let partial = py.import("functools")?.getattr("partial")?;
        Ok((partial.call((open, self.paths.clone()), Some(options.cast()?))?, ()))
    }

    fn __repr__(&self) -> String {
        let paths: Vec<String> = self.paths.iter().map(|path| format!("{path:?}")).collect();
        format!("open_log([{}])", paths.join(", "))
    }
}

#[pymethods]
impl TouchIterator {
    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__(&self, py: Python<'_>) -> Result<Option<Touch>> {
        let mut touches = Vec::new();
        py.detach(|| {
            let mut log = self.touches.lock().unwrap_or_else(PoisonError::into_inner);
            log.read_into(&mut touches, Some(1))
        })?;
        Ok(touches.pop().map(|touch| Touch::of(py, touch)))
    }
}

impl Touch {
    fn of(py: Python<'_>, touch: RecordedTouch) -> Self {
        let RecordedTouch { name, joint_names, samples, .. } = touch;
        let joints = samples.first().map_or(0, |sample| sample.q.len());
        let time: Option<Vec<f64>> = samples.iter().map(|sample| sample.time_s).collect();
        Self {
            name,
            q: table_of(py, samples.iter().map(|sample| &*sample.q), joints),
            tau: table_of(py, samples.iter().map(|sample| &*sample.tau), joints),
            time: time.map(|time| flat(py, time)),
            joint_names,
        }
    }

    fn recorded(&self, py: Python<'_>) -> RecordedTouch {
        let rows = |array: &Py<PyArray2<f64>>| {
            let array = array.bind(py).readonly();
            array.as_array().rows().into_iter().map(|row| row.to_vec()).collect()
        };
        let time = self.time.as_ref().map(|time| copied(py, time));
        RecordedTouch {
            log: PathBuf::new(),
            name: self.name.clone(),
            joint_names: self.joint_names.clone(),
            samples: samples(rows(&self.q), rows(&self.tau), time.as_deref()),
        }
    }
}

/// Samples from rows of positions and torques, with times if there are any.
fn samples(q: Vec<Vec<f64>>, tau: Vec<Vec<f64>>, time: Option<&[f64]>) -> Vec<Sample> {
    let rows = q.into_iter().zip(tau).enumerate();
    rows.map(|(row, (q, tau))| Sample::new(time.map(|time| time[row]), q, tau)).collect()
}

#[pymethods]
impl Touch {
    #[new]
    #[pyo3(signature = (q, tau, name = "touch", time = None, joint_names = None))]
    fn new(
        py: Python<'_>,
        q: &Bound<'_, PyAny>,
        tau: &Bound<'_, PyAny>,
        name: &str,
        time: Option<&Bound<'_, PyAny>>,
        joint_names: Option<Vec<String>>,
    ) -> PyResult<Self> {
        let q = rows(q, "q", None, "(T, n_joints)")?;
        let joints = q.first().map(Vec::len);
        let wanted = format!("({}, {}), as `q`", q.len(), joints.unwrap_or(0));
        let tau = rows(tau, "tau", joints, &wanted)?;
        if tau.len() != q.len() {
            let message = format!("`tau` has {} rows; wanted {wanted}", tau.len());
            return Err(PyValueError::new_err(message));
        }
        if let Some(names) = joint_names.as_ref().filter(|names| Some(names.len()) != joints) {
            let message = format!("`joint_names` has {} names; `q` is {wanted}", names.len());
            return Err(PyValueError::new_err(message));
        }
        let time = time.map(|time| row(time, "time", Some(q.len()))).transpose()?;
        let samples = samples(q, tau, time.as_deref());
        let (log, name) = (PathBuf::new(), name.to_owned());
        Ok(Self::of(py, RecordedTouch { log, name, joint_names, samples }))
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        (&self.q, &self.tau, &self.name, &self.time, self.joint_names.as_ref()).into_pyobject(py)
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.q.bind(py).shape()[0]
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!("Touch({:?}, {} frames)", self.name, self.__len__(py))
    }
}
