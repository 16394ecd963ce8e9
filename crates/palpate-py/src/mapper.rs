//! Learning: samples in, a field out.

use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::DVector;
use numpy::PyArray1;
use palpate::{EstimatorKind, ExternalTorqueConfig, MapperError, Sample, TorqueStream};
use palpate_io::field::{self, Saved};
use palpate_work::elastic::without_body;
use palpate_work::error::WorkError;
use palpate_work::settings::{OrAuto, Settings};
use palpate_work::touches::IfUndecided;
use palpate_work::{arm_file, learn, prior, resume};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict};
use serde_json::json;

use crate::array::{flat, row};
use crate::data::python;
use crate::error::{PalpateError, Result};
use crate::field::Field;
use crate::log::{opened, sources};
use crate::path_predictor::{Answer, PathPredictor, cluster_weight};
use crate::robot::{self, Robot};
use crate::settings;
use crate::shared::Shared;
use crate::watch::{long, unshown};

/// Learns a stiffness field from touches.
///
/// `robot` is a `Robot`, a name or a path; `method` is `map`, the exact maximum a posteriori, or
/// `ekf`, the paper's filter. `settings` are those of the command: the path of a TOML file or a dict
/// of its sections, over which `sections` are laid, such as `contact={"friction": 0.3}` or
/// `lattice=Lattice(...)`; `palpate.settings` has all keys. `prior` is a field that says what is
/// expected of its cells before they are touched. Threads that use one mapper wait for each other.
///
/// Raises SettingsError if a setting is unknown or out of its range.
#[pyclass(frozen, module = "palpate")]
pub(crate) struct Mapper {
    state: Shared<State>,
    robot: Robot,
    settings: Settings,
}

struct State {
    mapper: palpate::Mapper,
    /// Makes torques external ones, of an arm that was identified.
    stream: Option<TorqueStream>,
    /// Whether a touch was begun and not ended.
    in_touch: bool,
}

/// What one sample gave.
#[pyclass(frozen, module = "palpate", get_all)]
pub(crate) struct StepReport {
    /// Points touched.
    contacts: usize,
    /// External torque, gravity and tare taken off, (n_joints,) N·m; None while taring.
    external: Option<Py<PyArray1<f64>>>,
    /// What the field expected before it learnt from the sample, (n_joints,) N·m; None with that.
    predicted: Option<Py<PyArray1<f64>>>,
}

impl Mapper {
    fn of(mapper: palpate::Mapper, robot: Robot, settings: Settings) -> Result<Self> {
        let in_touch = false;
        let stream = match arm_file::of(&robot.settings, &robot.arm.robot)? {
            Some(model) => {
                let torques = settings.touch.over_config(&ExternalTorqueConfig::default());
                let stream = TorqueStream::new(Arc::clone(&robot.arm), model, torques);
                Some(stream.map_err(WorkError::Usage)?)
            }
            None => None,
        };
        Ok(Self { state: Shared::new(State { mapper, stream, in_touch }), robot, settings })
    }

    /// A mapper that goes on from a field.
    fn going_on(
        py: Python<'_>,
        (saved, name): (Saved, &str),
        robot: Robot,
        mut settings: Settings,
    ) -> Result<Self> {
        settings.robot.arm.clone_from(&robot.settings.arm);
        let mapper = unshown(py, |_| {
            let snapshot = resume::snapshot_of(saved, name, &settings)?;
            resume::mapper(name, &robot.arm, snapshot)
        })?;
        Self::of(mapper, robot, settings)
    }
}

#[pymethods]
impl Mapper {
    #[new]
    #[pyo3(signature = (robot = None, method = None, settings = None, prior = None, **sections))]
    fn new(
        py: Python<'_>,
        robot: Option<&Bound<'_, PyAny>>,
        method: Option<&str>,
        settings: Option<&Bound<'_, PyAny>>,
        prior: Option<&Bound<'_, Field>>,
        sections: Option<&Bound<'_, PyDict>>,
    ) -> Result<Self> {
        let mut settings = settings::read(settings, sections)?;
        if let Some(method) = method {
            let kind = EstimatorKind::named(method).ok_or_else(|| {
                let message = format!("`method` is {method:?}; wanted \"map\" or \"ekf\"");
                PyValueError::new_err(message)
            })?;
            settings.estimator.estimator = Some(kind);
        }
        if settings.estimator.estimator == Some(EstimatorKind::Elastic) {
            return Err(WorkError::from(without_body()).into());
        }
        let robot = robot::given(py, robot, &settings.robot)?;
        settings.robot.arm.clone_from(&robot.settings.arm);
        let config = settings.config()?;
        let prior = prior.map(|prior| prior.get().saved(py, false));
        let mapper = unshown(py, |progress| {
            let prior = prior.as_ref().map(|prior| (prior, "prior"));
            prior::mapper_from(prior, &robot.arm, config, progress)
        })?;
        Self::of(mapper, robot, settings)
    }

    /// Goes on from a field that `save` or `palpate map` wrote, as if it had never stopped.
    ///
    /// Settings, if given, must agree with the field's own. Raises PalpateError if it was saved
    /// without its memory or learnt with another robot.
    #[staticmethod]
    #[pyo3(signature = (path, robot = None, settings = None, **sections))]
    fn load(
        py: Python<'_>,
        path: PathBuf,
        robot: Option<&Bound<'_, PyAny>>,
        settings: Option<&Bound<'_, PyAny>>,
        sections: Option<&Bound<'_, PyDict>>,
    ) -> Result<Self> {
        let settings = settings::read(settings, sections)?;
        let robot = robot::given(py, robot, &settings.robot)?;
        let saved = py.detach(|| field::load(&path))?;
        Self::going_on(py, (saved, &path.display().to_string()), robot, settings)
    }

    /// Goes on from a field that has its memory, as `load` does from a file.
    #[staticmethod]
    #[pyo3(signature = (field, robot = None, settings = None, **sections))]
    fn from_field(
        py: Python<'_>,
        field: &Bound<'_, Field>,
        robot: Option<&Bound<'_, PyAny>>,
        settings: Option<&Bound<'_, PyAny>>,
        sections: Option<&Bound<'_, PyDict>>,
    ) -> Result<Self> {
        let settings = settings::read(settings, sections)?;
        let robot = robot::given(py, robot, &settings.robot)?;
        Self::going_on(py, (field.get().saved(py, true), "field"), robot, settings)
    }

    /// The arm.
    #[getter]
    fn robot(&self) -> Robot {
        self.robot.clone()
    }

    /// `map` or `ekf`.
    #[getter]
    fn method(&self, py: Python<'_>) -> PyResult<&'static str> {
        Ok(self.state.take(py)?.borrow().mapper.config().method.name())
    }

    /// The configuration that holds, as the field's file has it.
    #[getter]
    fn config<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        python(py, &json!(self.state.take(py)?.borrow().mapper.config()))
    }

    /// Starts a touch: the next samples belong to it, and its start gives the tare.
    ///
    /// `Field.without` forgets it by its name.
    #[pyo3(signature = (name = ""))]
    fn begin_touch(&self, py: Python<'_>, name: &str) -> PyResult<()> {
        let state = self.state.take(py)?;
        let mut state = state.borrow_mut();
        state.mapper.begin_touch();
        state.mapper.name_touch(name);
        if let Some(stream) = &mut state.stream {
            stream.begin();
        }
        state.in_touch = true;
        Ok(())
    }

    /// Learns from one sample: `q` (n_joints,) rad, `tau` (n_joints,) N·m as logged, `time` in s. One within
    /// 45 ms of the last that was learned from is only predicted. Without times, samples
    /// between which the fastest joint moves less than 2 mrad are thinned out.
    ///
    /// Raises TouchError if the sample cannot be used; it has then taught nothing.
    #[pyo3(signature = (q, tau, time = None))]
    fn step(
        &self,
        py: Python<'_>,
        q: &Bound<'_, PyAny>,
        tau: &Bound<'_, PyAny>,
        time: Option<f64>,
    ) -> Result<StepReport> {
        let joints = Some(self.robot.arm.robot.n_joints());
        let sample = Sample::new(time, row(q, "q", joints)?, row(tau, "tau", joints)?);
        let state = self.state.take(py)?;
        let mut state = state.borrow_mut();
        if !state.in_touch {
            let message = "there is no touch that this sample belongs to; call begin_touch() first";
            return Err(PalpateError::new_err(message).into());
        }
        let State { mapper, stream, .. } = &mut *state;
        if stream.is_some() {
            self.settings.torque_beside_robot().map_err(WorkError::from)?;
        }
        let report = py.detach(|| {
            let sample = match stream {
                Some(stream) => stream.external(&sample).map_err(MapperError::from)?,
                None => sample,
            };
            mapper.step(&sample)
        })?;
        let array = |torque: DVector<f64>| flat(py, torque.as_slice().to_vec());
        Ok(StepReport {
            contacts: report.contacts,
            external: report.external.map(array),
            predicted: report.predicted.map(array),
        })
    }

    /// Ends the touch. Raises TouchError if it was shorter than the tare asked for.
    fn end_touch(&self, py: Python<'_>) -> Result<()> {
        let state = self.state.take(py)?;
        let mut state = state.borrow_mut();
        state.in_touch = false;
        let mapper = &mut state.mapper;
        Ok(py.detach(|| mapper.end_touch())?)
    }

    /// Learns the touches of logs, given by path, as `Log` or as `Touch`, in their order.
    ///
    /// The cells are those of `palpate map --tune=off` to the bit. `progress` is None for a bar where somebody
    /// can see it, True, False, or a callable of frames done and in all. Ctrl-C raises
    /// KeyboardInterrupt; the mapper then knows all samples before it and can go on.
    #[pyo3(signature = (log, progress = None))]
    fn map<'py>(
        &self,
        py: Python<'py>,
        log: &Bound<'py, PyAny>,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> Result<Bound<'py, PyAny>> {
        let sources = sources(log)?;
        let state = self.state.take(py)?;
        let State { mapper, in_touch, .. } = &mut *state.borrow_mut();
        *in_touch = false; // a touch under way ends where the next one begins
        let settings = &self.settings.log;
        let figures = long(py, progress, |progress| -> Result<_, WorkError> {
            let mut touches = opened(sources, settings)?;
            let set = &mapper.config().touch;
            let mut given = self.settings.clone();
            if !set.identified {
                given.touch.torque_sign = Some(OrAuto::Is(set.torque_sign));
                given.touch.gravity = Some(OrAuto::Is(set.gravity));
            }
            let arm = mapper.arm().clone();
            touches.angle_unit(&arm, &mut given, progress)?;
            touches.external(&arm, &mut given, IfUndecided::LeaveOpen, progress)?;
            let place = (mapper.config().lattice.clone(), mapper.config().contact.clone());
            let mut touches = touches.for_arm(&mapper.arm().clone(), settings, place)?;
            let tally = learn::learn(mapper, &mut touches, &mut |_, _, _| (), None, progress)?;
            Ok(tally.figures(mapper))
        })?;
        Ok(python(py, &figures)?)
    }

    /// The field as it is now, with its memory: a snapshot, which later samples do not change.
    fn field(&self, py: Python<'_>) -> Result<Field> {
        let saved = Saved::of_mapper(&self.state.take(py)?.borrow().mapper);
        Field::of(py, saved)
    }

    /// What torque a motion would meet: `path` is (P, n_joints) rad.
    ///
    /// Joints go straight from point to point. A path that starts where the arm is in a touch under
    /// way goes on from the contacts there, if no point of the arm is further off than `start_cells`
    /// cells; any other starts free of contact. Between stops at most `resolution_cells` cells apart
    /// torques go in proportion; 0 stops at every point.
    ///
    /// Raises TouchError if the path cannot be followed.
    #[pyo3(signature = (path, resolution_cells = None, start_cells = None))]
    fn ask(
        &self,
        py: Python<'_>,
        path: &Bound<'_, PyAny>,
        resolution_cells: Option<f64>,
        start_cells: Option<f64>,
    ) -> Result<Answer> {
        self.path_predictor(py, false)?.ask(py, path, resolution_cells, start_cells, false)
    }

    /// The field and the arm as they are now, to say what torque many motions would meet.
    ///
    /// With `coarse`, clusters of cells count as one spring each: torques are off by some percent, and come
    /// several times as soon.
    #[pyo3(signature = (coarse = false))]
    fn path_predictor(&self, py: Python<'_>, coarse: bool) -> PyResult<PathPredictor> {
        let weight = cluster_weight(coarse);
        let predictor = self.state.take(py)?.borrow().mapper.coarse_path_predictor(weight);
        Ok(PathPredictor::of(predictor))
    }

    /// Writes the field as .npz, whole or not at all; without `memory` it cannot be gone on from.
    #[pyo3(signature = (path, memory = true))]
    fn save(&self, py: Python<'_>, path: PathBuf, memory: bool) -> Result<()> {
        let mut saved = Saved::of_mapper(&self.state.take(py)?.borrow().mapper);
        saved.snapshot.take_if(|_| !memory);
        Ok(py.detach(|| field::save(&path, &saved))?)
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let cells = self.state.take(py)?.borrow().mapper.n_cells();
        Ok(format!("Mapper({:?}, {cells} cells)", self.robot.arm.robot.name()))
    }
}

#[pymethods]
impl StepReport {
    fn __repr__(&self) -> String {
        let learnt = if self.external.is_some() { "learnt" } else { "taring" };
        format!("StepReport(contacts={}, {learnt})", self.contacts)
    }
}
