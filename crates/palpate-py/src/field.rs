//! A stiffness field, whose arrays are shared with NumPy.

use std::path::PathBuf;
use std::sync::Arc;

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyUntypedArrayMethods};
use palpate::unstable::ElasticModel;
use palpate::{Calibration, CellId, ContactConfig, ExternalTorqueConfig, Sample, Snapshot};
use palpate_io::field::{self, SavedField};
use palpate_work::change::compare;
use palpate_work::field_arrays::FieldArrays;
use palpate_work::forget::{TouchSelection, forget};
use palpate_work::held_joints::of_field;
use palpate_work::next::{RankingRequest, next};
use palpate_work::predict::{FrameResult, ReferenceTorque, TouchResult, planned, score};
use palpate_work::prediction_report::{PredictionReport, report_oddities};
use palpate_work::robot::warn_of_other_robot;
use palpate_work::settings::Settings;
use palpate_work::settings::sections::RobotSettings;
use palpate_work::touches::{IfUndecided, RecordedTouch, Touches};
use palpate_work::{Progress, WorkError};
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyBytes, PyDict};
use serde_json::json;

use crate::array::{copied, counts, flat, points, row, rows, table, table_of};
use crate::data::{named, python};
use crate::error::Result;
use crate::lattice::Lattice;
use crate::log::{Source, opened, sources};
use crate::path_predictor::{PathPredictor, cluster_weight};
use crate::watch::{long, unshown};
use crate::{robot, settings};

/// Stiffness, std and counts at points.
type Estimates = (Py<PyArray1<f64>>, Py<PyArray1<f64>>, Py<PyArray1<u32>>);

/// The stiffness of N cells that were touched or have a prior of their own.
///
/// Arrays are read-only and share the memory of the field; each access returns the same object.
#[pyclass(frozen, module = "palpate")]
pub(crate) struct Field {
    /// Rest points, (N, 3), m, frame of the robot's base.
    #[pyo3(get)]
    points: Py<PyArray2<f64>>,
    /// K of each point, (N,), N/m, never negative.
    #[pyo3(get)]
    stiffness: Py<PyArray1<f64>>,
    /// Standard deviation of K, (N,), N/m.
    #[pyo3(get)]
    std: Py<PyArray1<f64>>,
    /// Number of frames that touched each cell, (N,); 0 if its stiffness is only a prior.
    #[pyo3(get)]
    counts: Py<PyArray1<u32>>,
    /// Cell number of each point in the lattice, (N,).
    #[pyo3(get)]
    cells: Py<PyArray1<u32>>,
    /// Prior mean of K, (N,), N/m; None if it is the same for all cells.
    #[pyo3(get)]
    prior: Option<Py<PyArray1<f64>>>,
    /// The lattice that contains the cells.
    #[pyo3(get)]
    lattice: Py<Lattice>,
    /// Name of the robot with which it was learnt.
    #[pyo3(get, name = "robot_name")]
    robot: String,
    /// K of all other cells, N/m.
    #[pyo3(get, name = "untouched")]
    untouched_n_per_m: f64,
    contact: ContactConfig,
    touch: ExternalTorqueConfig,
    snapshot: Option<Snapshot>,
    elastic: Option<Arc<ElasticModel>>,
    calibration: Option<Calibration>,
    elastic_touches: Vec<Vec<Sample>>,
}

impl Field {
    /// Moves the arrays of a field to NumPy arrays.
    pub(crate) fn of(py: Python<'_>, saved: SavedField) -> Result<Self> {
        let SavedField { field, prior_n_per_m, robot, snapshot, elastic_touches } = saved;
        let point = |cell: &CellId| <[f64; 3]>::from(field.lattice.point(*cell));
        let places: Vec<[f64; 3]> = field.cells.iter().map(point).collect();
        Ok(Self {
            points: table(py, places.into_flattened(), 3),
            stiffness: flat(py, field.stiffness_n_per_m),
            std: flat(py, field.std_n_per_m),
            counts: flat(py, field.counts),
            cells: flat(py, field.cells.into_iter().map(|cell| cell.0).collect()),
            prior: prior_n_per_m.map(|prior| flat(py, prior)),
            lattice: Py::new(py, Lattice { inner: field.lattice })?,
            contact: field.contact,
            touch: field.touch,
            untouched_n_per_m: field.untouched_n_per_m,
            robot,
            snapshot,
            elastic: field.elastic,
            calibration: field.calibration,
            elastic_touches,
        })
    }

    /// A copy as a field of the core crate.
    pub(crate) fn core(&self, py: Python<'_>) -> palpate::Field {
        let (contact, touch) = (self.contact.clone(), self.touch.clone());
        let lattice = self.lattice.get().inner.clone();
        let mut field = palpate::Field::new(lattice, contact, touch, self.untouched_n_per_m);
        field.cells = copied(py, &self.cells).into_iter().map(CellId).collect();
        field.stiffness_n_per_m = copied(py, &self.stiffness);
        field.std_n_per_m = copied(py, &self.std);
        field.counts = copied(py, &self.counts);
        field.elastic.clone_from(&self.elastic);
        field.calibration.clone_from(&self.calibration);
        field
    }

    /// A copy with everything that a file contains; with `memory`, also its snapshot and touches.
    pub(crate) fn saved(&self, py: Python<'_>, memory: bool) -> SavedField {
        SavedField {
            field: self.core(py),
            prior_n_per_m: self.prior.as_ref().map(|prior| copied(py, prior)),
            robot: self.robot.clone(),
            snapshot: self.snapshot.as_ref().filter(|_| memory).cloned(),
            elastic_touches: if memory { self.elastic_touches.clone() } else { Vec::new() },
        }
    }

    /// Standard deviation of untouched cells, N/m; NaN if the field has no memory.
    fn untouched_std(&self) -> f64 {
        self.snapshot.as_ref().map_or(f64::NAN, |snapshot| {
            let config = &snapshot.config;
            config.estimator.prior.at_spacing(config.lattice.spacing_m()).1
        })
    }

    /// The robot of an argument; for `None`, the robot of the field, loaded by its name.
    pub(crate) fn robot(
        &self,
        py: Python<'_>,
        any: Option<&Bound<'_, PyAny>>,
    ) -> Result<robot::Robot> {
        let own = RobotSettings { robot: Some(self.robot.clone()), ..RobotSettings::default() };
        let robot = robot::given(py, any, &own)?;
        let snapshot = self.snapshot.as_ref();
        let arm = unshown(py, |progress| {
            let arm = of_field(Arc::clone(&robot.arm), snapshot, progress);
            warn_of_other_robot((&self.robot, snapshot), &arm, progress);
            Ok::<_, WorkError>(arm)
        })?;
        Ok(robot::Robot { arm, ..robot })
    }
}

#[pymethods]
impl Field {
    /// Reads a field that `save` or `palpate map` wrote. Raises FileError.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> Result<Self> {
        Self::of(py, py.detach(|| field::load(&path))?)
    }

    /// Writes the field as .npz, never partially; `memory` is whether to include its memory, if it has one.
    #[pyo3(signature = (path, memory = true))]
    fn save(&self, py: Python<'_>, path: PathBuf, memory: bool) -> Result<()> {
        let saved = self.saved(py, memory);
        Ok(py.detach(|| field::save(&path, &saved))?)
    }

    /// A field from arrays: `points` (N, 3) m, `stiffness` (N,) N/m, `std` (N,) N/m, `counts` (N,).
    ///
    /// Points must be points of `lattice`, each at most once; `Lattice.cells` finds the nearest.
    /// `std` is 0 and `counts` 1 if left out; a count of 0 means that a stiffness is only a prior.
    /// `untouched` is the stiffness of all other cells, N/m. The contact model, and sign, gravity and
    /// tare of torques, are those of the settings. Raises ValueError, which names the array and the row.
    #[staticmethod]
    #[pyo3(signature = (
        points, stiffness, std = None, counts = None, *, lattice, untouched = 0.0,
        robot = "kinova_gen3", settings = None, **sections
    ))]
    #[allow(clippy::too_many_arguments)] // they are keywords
    fn from_arrays(
        py: Python<'_>,
        points: &Bound<'_, PyAny>,
        stiffness: &Bound<'_, PyAny>,
        std: Option<&Bound<'_, PyAny>>,
        counts: Option<&Bound<'_, PyAny>>,
        lattice: &Bound<'_, Lattice>,
        untouched: f64,
        robot: &str,
        settings: Option<&Bound<'_, PyAny>>,
        sections: Option<&Bound<'_, PyDict>>,
    ) -> Result<Self> {
        let points_m = self::points(points, "points")?;
        let n = points_m.len();
        let given = FieldArrays {
            stiffness_n_per_m: row(stiffness, "stiffness", Some(n))?,
            std_n_per_m: std.map_or(Ok(vec![0.0; n]), |std| row(std, "std", Some(n)))?,
            counts: counts.map_or(Ok(vec![1; n]), |counts| self::counts(counts, "counts"))?,
            points_m,
            untouched_n_per_m: untouched,
        };
        let mut config = settings::read(settings, sections)?.config()?;
        config.lattice = lattice.get().inner.clone();
        Self::of(py, given.field(&config, robot)?)
    }

    /// Settings of the contact model with which it was learnt, in the form of `contact=`.
    #[getter]
    fn contact<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        python(py, &json!(self.contact))
    }

    /// Whether the field has its memory, so that mapping can be resumed and touches can be forgotten.
    #[getter]
    fn has_memory(&self) -> bool {
        self.snapshot.is_some()
    }

    /// Stiffness (M,) N/m, its std (M,) N/m and counts (M,) of the cells at `points` (M, 3) m.
    ///
    /// Cells never touched have stiffness and std of the prior (std NaN if the field has no memory) and a
    /// count of 0; outside of the lattice, stiffness and std are NaN.
    fn query(&self, py: Python<'_>, points: &Bound<'_, PyAny>) -> PyResult<Estimates> {
        let places = self::points(points, "points")?;
        let (field, std) = (self.core(py), self.untouched_std());
        let found = py.detach(|| field.at(&places, std));
        let number = |of: fn(&palpate::CellEstimate) -> f64| {
            found.iter().map(|cell| cell.as_ref().map_or(f64::NAN, of)).collect()
        };
        let stiffness = flat(py, number(|cell| cell.stiffness_n_per_m));
        let std = flat(py, number(|cell| cell.std_n_per_m));
        let count = found.iter().map(|cell| cell.map_or(0, |cell| cell.count)).collect();
        Ok((stiffness, std, flat(py, count)))
    }

    /// Predicts the external torque along a motion: `q_path` (T, n_joints) rad gives (T, n_joints) N·m.
    ///
    /// The motion starts free of contact, and every row is a step, as in `palpate predict`. If `robot` is
    /// left out, it is loaded by `robot_name`.
    #[pyo3(signature = (q_path, robot = None, progress = None))]
    fn predict(
        &self,
        py: Python<'_>,
        q_path: &Bound<'_, PyAny>,
        robot: Option<&Bound<'_, PyAny>>,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> Result<Py<PyArray2<f64>>> {
        let robot = self.robot(py, robot)?;
        let joints = robot.arm.robot.n_joints();
        let path = rows(q_path, "q_path", Some(joints), &format!("(T, {joints})"))?;
        let field = self.core(py);
        let torques = long(py, progress, |progress| planned(&robot.arm, &field, &path, progress))?;
        Ok(table_of(py, torques.iter().map(|torque| torque.as_slice()), joints))
    }

    /// A copy of the field, to predict the torque of many motions of an arm.
    ///
    /// If `robot` is left out, it is loaded by `robot_name`. With `coarse`, each cluster of cells is one
    /// spring: this is several times faster, and torques differ by some percent.
    #[pyo3(signature = (robot = None, *, coarse = false))]
    fn path_predictor(
        &self,
        py: Python<'_>,
        robot: Option<&Bound<'_, PyAny>>,
        coarse: bool,
    ) -> Result<PathPredictor> {
        let (robot, field) = (self.robot(py, robot)?, self.core(py));
        let calibrated = field.bands().map(|own| own.untouched_std_n_per_m);
        let std = calibrated.unwrap_or_else(|| self.untouched_std());
        let weight = cluster_weight(coarse);
        let predictor = palpate::PathPredictor::of_field(&robot.arm, &field, std, weight);
        Ok(PathPredictor::of(predictor.map_err(|error| {
            WorkError::from(palpate_work::settings::SettingsError::value(error))
        })?))
    }

    /// Predicts the touches of logs and compares with the measured torque, as `palpate predict` does.
    ///
    /// `truth` compares with the true torques that are stored beside simulated touches. The settings may
    /// change how the log is read (`log`), and sign, gravity and tare of its torques (`touch`).
    #[pyo3(signature = (log, robot = None, *, truth = false, settings = None, progress = None, **sections))]
    #[allow(clippy::too_many_arguments)] // they are keywords
    fn score<'py>(
        &self,
        py: Python<'py>,
        log: &Bound<'py, PyAny>,
        robot: Option<&Bound<'py, PyAny>>,
        truth: bool,
        settings: Option<&Bound<'py, PyAny>>,
        progress: Option<&Bound<'py, PyAny>>,
        sections: Option<&Bound<'py, PyDict>>,
    ) -> Result<Bound<'py, PyAny>> {
        let settings = settings::read(settings, sections)?;
        let robot = self.robot(py, robot)?;
        let (sources, field) = (sources(log)?, self.core(py));
        let against = if truth { ReferenceTorque::Truth } else { ReferenceTorque::Measured };
        let results = long(py, progress, |progress| -> Result<_, WorkError> {
            let (mut touches, touch) = beside((&field, &robot), (sources, settings), progress)?;
            let learnt = (&field, self.snapshot.as_ref());
            let results = score(&robot.arm, learnt, touch, against, (&mut touches, progress))?;
            report_oddities(&results, &field, progress);
            Ok(results)
        })?;
        Ok(scored(py, &results, (&field, against), robot.arm.robot.n_joints())?)
    }

    /// Tests whether touches of logs contradict the field, and what has changed, as `palpate compare` does.
    ///
    /// The settings may change how the log is read (`log`), and sign, gravity and tare of its torques
    /// (`touch`). Raises FileError if no touches were held out when the field was learned.
    #[pyo3(signature = (log, robot = None, *, settings = None, progress = None, **sections))]
    #[allow(clippy::too_many_arguments)] // they are keywords
    fn compare<'py>(
        &self,
        py: Python<'py>,
        log: &Bound<'py, PyAny>,
        robot: Option<&Bound<'py, PyAny>>,
        settings: Option<&Bound<'py, PyAny>>,
        progress: Option<&Bound<'py, PyAny>>,
        sections: Option<&Bound<'py, PyDict>>,
    ) -> Result<Bound<'py, PyAny>> {
        let settings = settings::read(settings, sections)?;
        let robot = self.robot(py, robot)?;
        let (sources, saved) = (sources(log)?, self.saved(py, true));
        let report = long(py, progress, |progress| {
            let (touches, touch) = beside((&saved.field, &robot), (sources, settings), progress)?;
            compare(&robot.arm, &saved, touch, touches, progress)
        })?;
        Ok(python(py, &json!(report))?)
    }

    /// Ranks candidate motions by how much they would teach, the best first, as `palpate next` does.
    ///
    /// Each is ranked as if those before it were already made. `candidates` are the possible motions,
    /// (T, n_joints) rad each; `task` are the motions whose torques are to be predicted, by default the
    /// candidates. With `box`, a pair of corners, m, the stiffness in this box is to be known instead. `by`
    /// is the criterion, "variance" or "information". Motions are excluded if their predicted torque may
    /// exceed `limit`, N·m, or if a joint exceeds its limits. With an elastic body, `limit` needs bands.
    #[pyo3(signature = (
        candidates, task = None, *, r#box = None, by = "variance", count = 5, limit = None, robot = None, progress = None
    ))]
    #[allow(clippy::too_many_arguments)] // they are keywords
    fn next<'py>(
        &self,
        py: Python<'py>,
        candidates: Vec<Bound<'py, PyAny>>,
        task: Option<Vec<Bound<'py, PyAny>>>,
        r#box: Option<[[f64; 3]; 2]>,
        by: &str,
        count: usize,
        limit: Option<f64>,
        robot: Option<&Bound<'py, PyAny>>,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> Result<Bound<'py, PyAny>> {
        let robot = self.robot(py, robot)?;
        let joints = robot.arm.robot.n_joints();
        let candidates = motions(&candidates, "candidates", joints)?;
        let task = motions(&task.unwrap_or_default(), "task", joints)?;
        let criterion = named("by", by, "\"variance\" or \"information\"")?;
        let request = RankingRequest { criterion, count, limit_n_m: limit, box_m: r#box };
        let saved = self.saved(py, true);
        let found = long(py, progress, |progress| {
            next(&robot.arm, &saved, (&candidates, &task), &request, progress)
        })?;
        Ok(python(py, &json!(found))?)
    }

    /// A copy of the field in which some of its touches were never learnt, as `palpate forget` makes it.
    ///
    /// Forgotten are the `touches` with these names or numbers (such as "#3"), all touches before the last
    /// `older_than`, and those that touched a cell in `box`, a pair of corners, m. Raises PalpateError if the
    /// field has no memory, or the other touches cannot all be learnt again.
    #[pyo3(signature = (touches = None, *, older_than = None, r#box = None, robot = None, progress = None))]
    #[allow(clippy::too_many_arguments)] // they are keywords
    fn without(
        &self,
        py: Python<'_>,
        touches: Option<Vec<String>>,
        older_than: Option<usize>,
        r#box: Option<[[f64; 3]; 2]>,
        robot: Option<&Bound<'_, PyAny>>,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> Result<Self> {
        let robot = self.robot(py, robot)?;
        let which =
            TouchSelection { names: touches.unwrap_or_default(), older_than, touched_box_m: r#box };
        let saved = self.saved(py, true);
        let without = long(py, progress, |progress| {
            let (mapper, _) = forget(&robot.arm, (&saved, "the field"), &which, progress)?;
            Ok::<_, WorkError>(SavedField::of_mapper(&mapper))
        })?;
        Self::of(py, without)
    }

    fn __len__(&self, py: Python<'_>) -> usize {
        self.stiffness.bind(py).shape()[0]
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let counts = self.counts.bind(py).readonly();
        let touched = counts.as_array().iter().filter(|&&count| count > 0).count();
        let (cells, spacing) = (self.__len__(py), self.lattice.get().inner.spacing_m());
        format!("Field({cells} cells, {touched} touched, every {spacing} m)")
    }

    fn __reduce__<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        let saved = self.saved(py, true);
        let bytes = py.detach(|| field::to_bytes(&saved));
        let restore = py.import("palpate._palpate")?.getattr("unpickled_field")?;
        Ok((restore, (PyBytes::new(py, &bytes),)))
    }
}

/// Touches to compare with a field, and sign, gravity and tare of their torques.
fn beside(
    (field, robot): (&palpate::Field, &robot::Robot),
    (sources, mut settings): (Vec<Source>, Settings),
    progress: &dyn Progress,
) -> std::result::Result<(Touches, ExternalTorqueConfig), WorkError> {
    let mut touches = opened(sources, &settings.log)?;
    touches.angle_unit(&robot.arm, &mut settings, progress)?;
    settings.robot.arm.clone_from(&robot.settings.arm);
    touches.prepare_torques(&robot.arm, &mut settings, IfUndecided::LeaveOpen, progress)?;
    let touch = settings.torque_convention_for_field(&field.touch)?;
    Ok((touches.for_arm(&robot.arm, &settings.log, field.lattice.clone())?, touch))
}

/// Motions from arrays, named by their index.
fn motions(arrays: &[Bound<'_, PyAny>], name: &str, joints: usize) -> Result<Vec<RecordedTouch>> {
    let motion = |(number, array): (usize, &Bound<'_, PyAny>)| {
        let path =
            rows(array, &format!("{name}[{number}]"), Some(joints), &format!("(T, {joints})"))?;
        let sample = |q: Vec<f64>| Sample::new(None, q.clone(), vec![0.0; q.len()]);
        let samples = path.into_iter().map(sample).collect();
        Ok(RecordedTouch { name: format!("{name}[{number}]"), samples, ..RecordedTouch::default() })
    };
    arrays.iter().enumerate().map(motion).collect()
}

/// The report of `palpate predict --json`, with the torques of each touch added.
fn scored<'py>(
    py: Python<'py>,
    results: &[TouchResult],
    (field, against): (&palpate::Field, ReferenceTorque),
    joints: usize,
) -> PyResult<Bound<'py, PyAny>> {
    let report = python(py, &json!(PredictionReport::new(results, (field, against))))?;
    let touches = report.get_item("touches")?;
    for (touch, result) in touches.try_iter()?.zip(results) {
        let (touch, frames) = (touch?, &result.frames);
        let torques = |of: fn(&FrameResult) -> &[f64]| table_of(py, frames.iter().map(of), joints);
        touch.set_item("predicted", torques(|frame| frame.predicted.as_slice()))?;
        touch.set_item("external", torques(|frame| frame.external.as_slice()))?;
        let band = result.band(field).map(|band| band.half_width);
        let band = band.map(|rows| table_of(py, rows.iter().map(Vec::as_slice), joints));
        touch.set_item("half_width", band)?;
        touch.set_item("frame", flat(py, frames.iter().map(|frame| frame.frame).collect()))?;
        let contacts = frames.iter().map(|frame| frame.contacts as u64).collect();
        touch.set_item("contacts", flat(py, contacts))?;
        let time: Option<Vec<f64>> = frames.iter().map(|frame| frame.time_s).collect();
        touch.set_item("time", time.map(|time| flat(py, time)))?;
    }
    Ok(report)
}

/// Restores a field from its pickled bytes.
#[pyfunction]
pub(crate) fn unpickled_field(py: Python<'_>, bytes: &[u8]) -> Result<Field> {
    Field::of(py, field::from_bytes(bytes, "the pickled field")?)
}
