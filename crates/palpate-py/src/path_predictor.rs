//! Predicts the torque of planned motions.

use nalgebra::DVector;
use numpy::{PyArray1, PyArray2};
use palpate::{CLUSTER_WEIGHT, PathConfig, PathPoint, PathPrediction};
use palpate_work::Progress;
use pyo3::exceptions::{PyKeyboardInterrupt, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::PyAny;

use crate::array::{flat, rows, table_of};
use crate::error::{Result, TouchError};
use crate::watch::unshown;

/// A copy of a field and of the arm's contacts, to predict the torque of motions.
///
/// `Field.path_predictor` and `Mapper.path_predictor` return it. It never changes, and threads may share it.
#[pyclass(frozen, module = "palpate")]
pub(crate) struct PathPredictor {
    inner: palpate::PathPredictor,
}

/// Predicted torques along a path of P points.
#[pyclass(frozen, module = "palpate", get_all)]
pub(crate) struct Answer {
    /// Predicted external torque, (P, n_joints), N·m.
    torque: Py<PyArray2<f64>>,
    /// Standard deviation of `torque` from the uncertainty of the springs alone, (P, n_joints), N·m.
    ///
    /// Use it to rank paths by how well their torque is known; it is no bound of the error.
    torque_std: Py<PyArray2<f64>>,
    /// Half-width of the band around `torque`, (P, n_joints), N·m; None if the field has no bands.
    ///
    /// Its level is 90 %, or the highest level of the field if that is lower.
    half_width: Option<Py<PyArray2<f64>>>,
    /// As `half_width`, of the band for the largest torque of a joint along the path, (P, n_joints), N·m.
    peak_half_width: Option<Py<PyArray2<f64>>>,
    /// Number of cells touched, (P,).
    contacts: Py<PyArray1<u64>>,
    /// Number of these cells that were touched when the field was learnt, (P,).
    known: Py<PyArray1<u64>>,
    /// Whether the path continued from the arm's contacts, rather than free of contact.
    goes_on: bool,
    /// Number of points at which contacts were computed; torques at the others are interpolated.
    stops: usize,
}

/// The weight of a cluster of springs, in average springs.
pub(crate) const fn cluster_weight(coarse: bool) -> f64 {
    if coarse { CLUSTER_WEIGHT } else { 1.0 }
}

impl PathPredictor {
    pub(crate) fn of(inner: palpate::PathPredictor) -> Self {
        Self { inner }
    }

    /// The path of an argument, one row for each point.
    fn path(&self, any: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<Vec<f64>>> {
        let joints = self.inner.n_joints();
        rows(any, name, Some(joints), &format!("(P, {joints})"))
    }
}

/// The settings of a query.
fn config(resolution_cells: Option<f64>, start_cells: Option<f64>, inside: bool) -> PathConfig {
    let mut config = PathConfig::default();
    config.resolution_cells = resolution_cells.unwrap_or(config.resolution_cells);
    config.start_cells = start_cells.unwrap_or(config.start_cells);
    config.inside = inside;
    config
}

#[pymethods]
impl PathPredictor {
    /// Number of joints: columns of a path.
    #[getter]
    fn n_joints(&self) -> usize {
        self.inner.n_joints()
    }

    /// Predicts the external torque along a motion: `path` is (P, n_joints) rad.
    ///
    /// Arguments are those of `Mapper.ask`. A path that does not continue from the contacts of the arm starts
    /// free of contact: cells that the links cover at its first point count as empty. With `inside`, these cells
    /// are pushed out to the nearest surface instead: for a posture, or a piece of a path, in the object.
    ///
    /// Raises TouchError if the path cannot be followed.
    #[pyo3(signature = (path, resolution_cells = None, start_cells = None, inside = false))]
    pub(crate) fn ask(
        &self,
        py: Python<'_>,
        path: &Bound<'_, PyAny>,
        resolution_cells: Option<f64>,
        start_cells: Option<f64>,
        inside: bool,
    ) -> Result<Answer> {
        let path = self.path(path, "path")?;
        let config = config(resolution_cells, start_cells, inside);
        let answer = unshown(py, |_| self.inner.ask(&path, &config))?;
        Ok(Answer::of(py, answer, self.inner.n_joints()))
    }

    /// Predicts the external torque along several motions in parallel; results are identical to those of `ask`.
    ///
    /// Raises TouchError, with the number of the path, if one cannot be followed.
    #[pyo3(signature = (paths, resolution_cells = None, start_cells = None, inside = false))]
    fn ask_all(
        &self,
        py: Python<'_>,
        paths: &Bound<'_, PyAny>,
        resolution_cells: Option<f64>,
        start_cells: Option<f64>,
        inside: bool,
    ) -> Result<Vec<Answer>> {
        let several = paths.try_iter().map_err(|_| {
            PyTypeError::new_err(
                "`paths` is not a sequence; wanted several paths, (P, n_joints) each",
            )
        })?;
        let path = |(number, path): (usize, PyResult<Bound<'_, PyAny>>)| {
            self.path(&path?, &format!("paths[{number}]"))
        };
        let paths: Vec<_> = several.enumerate().map(path).collect::<PyResult<_>>()?;
        let config = config(resolution_cells, start_cells, inside);
        let answers = unshown(py, |progress| {
            let answers = self.inner.ask_all(&paths, &config, || progress.stopped());
            answers
                .map_err(|(number, error)| TouchError::new_err(format!("path {number}: {error}")))
        })?;
        let answers = answers.ok_or_else(|| PyKeyboardInterrupt::new_err(()))?;
        let joints = self.inner.n_joints();
        Ok(answers.into_iter().map(|answer| Answer::of(py, answer, joints)).collect())
    }

    fn __repr__(&self) -> String {
        format!("PathPredictor({} joints)", self.inner.n_joints())
    }
}

impl Answer {
    fn of(py: Python<'_>, answer: PathPrediction, joints: usize) -> Self {
        let level = answer.calibration.as_ref().map(|own| own.default_level());
        let widths = [PathPrediction::half_width, PathPrediction::peak_half_width].map(|of| {
            let rows = level.and_then(|level| of(&answer, level))?;
            Some(table_of(py, rows.iter().map(|row| row.as_slice()), joints))
        });
        let [half_width, peak_half_width] = widths;
        let PathPrediction { points, goes_on, stops, .. } = answer;
        let torques = |of: fn(&PathPoint) -> &DVector<f64>| {
            table_of(py, points.iter().map(|point| of(point).as_slice()), joints)
        };
        let counts = |of: fn(&PathPoint) -> usize| {
            flat(py, points.iter().map(|point| of(point) as u64).collect())
        };
        Self {
            torque: torques(|point| &point.torque),
            torque_std: torques(|point| &point.torque_std),
            half_width,
            peak_half_width,
            contacts: counts(|point| point.contacts),
            known: counts(|point| point.known),
            goes_on,
            stops,
        }
    }
}

#[pymethods]
impl Answer {
    fn __repr__(&self) -> String {
        format!("Answer(stops={}, goes_on={})", self.stops, self.goes_on)
    }
}
