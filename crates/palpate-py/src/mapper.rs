//! Learning: samples in, a field out.

use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::DVector;
use numpy::PyArray1;
use palpate::unstable::{LogPosition, TouchLog};
use palpate::{
    EstimatorKind, ExternalTorqueConfig, MapperConfig, MapperError, Sample, TorqueStream,
};
use palpate_io::field::{self, SavedField};
use palpate_learn::LearnError;
use palpate_learn::choose::{Chosen, MIN_TUNING_TOUCHES, choose_for_log, refusal};
use palpate_work::Progress;
use palpate_work::elastic::without_body;
use palpate_work::error::WorkError;
use palpate_work::settings::{OrAuto, Settings};
use palpate_work::touches::IfUndecided;
use palpate_work::tune::given;
use palpate_work::{arm_file, learn, prior, resume};
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict};
use serde_json::json;

use crate::array::{flat, row};
use crate::data::{named, python};
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
/// of its sections; `sections` override them, such as `contact={"friction": 0.3}` or
/// `lattice=Lattice(...)`; `palpate.settings` has all keys. `prior` is a field whose prior means, or else
/// learnt stiffness, are the prior means of the cells. Threads that use the same mapper wait for each other.
///
/// Raises SettingsError if a setting is unknown or out of its range.
#[pyclass(frozen, module = "palpate")]
pub(crate) struct Mapper {
    state: Shared<State>,
    robot: Robot,
    settings: Settings,
    /// The configuration with which it began; `None` if it continues a field.
    initial: Option<MapperConfig>,
    /// The settings for samples one by one, with sign and gravity of the torques as in the file of an identified arm.
    stream_settings: Settings,
}

struct State {
    mapper: palpate::Mapper,
    /// Computes external torques, for an identified arm.
    stream: Option<TorqueStream>,
    /// Whether a touch is under way.
    in_touch: bool,
}

/// Result of one sample.
#[pyclass(frozen, module = "palpate", get_all)]
pub(crate) struct StepReport {
    /// Number of cells touched.
    contacts: usize,
    /// External torque, with gravity and tare subtracted, (n_joints,) N·m; None while taring.
    external: Option<Py<PyArray1<f64>>>,
    /// External torque predicted before the sample was learnt, (n_joints,) N·m; None while taring.
    predicted: Option<Py<PyArray1<f64>>>,
}

impl Mapper {
    fn of(mapper: palpate::Mapper, robot: Robot, settings: Settings) -> Result<Self> {
        let in_touch = false;
        let mut stream_settings = settings.clone();
        stream_settings.robot.arm.clone_from(&robot.settings.arm);
        arm_file::complete_convention(&mut stream_settings, &robot.arm.robot)?;
        let stream = match arm_file::of(&robot.settings, &robot.arm.robot)? {
            Some(model) => {
                let torques = stream_settings.touch.over_config(&ExternalTorqueConfig::default());
                let stream = TorqueStream::new(Arc::clone(&robot.arm), model, torques);
                Some(stream.map_err(WorkError::Usage)?)
            }
            None => None,
        };
        let initial = Some(mapper.config().clone());
        let state = Shared::new(State { mapper, stream, in_touch });
        Ok(Self { state, robot, settings, initial, stream_settings })
    }

    /// A mapper that resumes from a field.
    fn going_on(
        py: Python<'_>,
        (saved, name): (SavedField, &str),
        robot: Robot,
        mut settings: Settings,
    ) -> Result<Self> {
        settings.robot.arm.clone_from(&robot.settings.arm);
        let mapper = unshown(py, |progress| {
            let snapshot = resume::snapshot_of(saved, name, &robot.arm, &settings)?;
            resume::mapper(name, &robot.arm, snapshot, progress)
        })?;
        Ok(Self { initial: None, ..Self::of(mapper, robot, settings)? })
    }

    /// A mapper that has learnt the touches of a log with settings chosen for them, and what was chosen.
    fn chosen_for(
        &self,
        (initial, log): (&MapperConfig, &TouchLog),
        progress: &dyn Progress,
    ) -> Result<(palpate::Mapper, String), WorkError> {
        let (arm, stopped) = (&self.robot.arm, || progress.stopped());
        let interrupted = || WorkError::Interrupted { kept: String::new() };
        progress.note("choosing settings");
        let found = choose_for_log((arm, initial), log, given(&self.settings), &stopped);
        let found = found.map_err(|error| match error {
            LearnError::Stopped => interrupted(),
            error => WorkError::from(error.to_string()),
        })?;
        let Some((Chosen { tuned, calibration }, summary)) = found else {
            return Err(WorkError::from(format!(
                "choosing settings needs {MIN_TUNING_TOUCHES} touches in which the arm touches something"
            )));
        };
        if let Some(why) = refusal(&tuned) {
            return Err(WorkError::from(format!("the settings stay as they are: {why}")));
        }
        let learn = || {
            let mapper = palpate::Mapper::new(Arc::clone(arm), tuned.config)?;
            let mut mapper = mapper.with_calibration(calibration);
            Ok::<_, MapperError>(mapper.catch_up(log, || !stopped())?.then_some(mapper))
        };
        let mapper = learn().map_err(|error| WorkError::from(error.to_string()))?;
        Ok((mapper.ok_or_else(interrupted)?, summary))
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
            let kind = named("method", method, "\"map\" or \"ekf\"")?;
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

    /// Resumes mapping from a field that `save` or `palpate map` wrote, as if it had not been interrupted.
    ///
    /// Settings, if given, must agree with those of the field. Raises PalpateError if the field was saved
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

    /// Resumes mapping from a field with memory, as `load` does from a file.
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

    /// The complete configuration, in the form that the field's file contains.
    #[getter]
    fn config<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        python(py, &json!(self.state.take(py)?.borrow().mapper.config()))
    }

    /// Starts a touch: the next samples belong to it, and the first of them give the tare.
    ///
    /// `Field.without` can forget the touch by its name.
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

    /// Learns from one sample: `q` (n_joints,) rad, `tau` (n_joints,) N·m as logged, `time` in s. A sample
    /// within 45 ms of the last learnt one is only predicted. Without times, samples between which the fastest
    /// joint moves less than 2 mrad are thinned out.
    ///
    /// Raises TouchError if the sample cannot be used; nothing is then learnt from it.
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
            self.stream_settings.torque_convention_for_robot().map_err(WorkError::from)?;
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

    /// Ends the touch. Raises TouchError if it had fewer samples than the tare of the settings.
    fn end_touch(&self, py: Python<'_>) -> Result<()> {
        let state = self.state.take(py)?;
        let mut state = state.borrow_mut();
        state.in_touch = false;
        let mapper = &mut state.mapper;
        Ok(py.detach(|| mapper.end_touch())?)
    }

    /// Learns the touches of logs, given by path, as `Log` or as `Touch`, in their order.
    ///
    /// The field is identical to that of `palpate map --tune=off`. `progress` is None for a bar if a terminal
    /// or notebook shows it, True, False, or a callable that gets the numbers of frames done and in total.
    /// Ctrl-C raises KeyboardInterrupt; the mapper has then learnt all earlier samples and can continue.
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
        *in_touch = false; // the first touch of the log ends a touch under way
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
            touches.prepare_torques(&arm, &mut given, IfUndecided::LeaveOpen, progress)?;
            let lattice = mapper.config().lattice.clone();
            let mut touches = touches.for_arm(&mapper.arm().clone(), settings, lattice)?;
            let tally = learn::learn(mapper, &mut touches, &mut |_, _, _| (), None, progress)?;
            Ok(tally.figures(mapper))
        })?;
        Ok(python(py, &figures)?)
    }

    /// Chooses the settings that were not given, by cross-validation on the touches in memory as `palpate map` does, and
    /// learns these touches again with them.
    ///
    /// This takes about ten seconds for eleven touches. Meanwhile other threads can use the mapper; what they learn is
    /// kept. Returns what was chosen, in one line. `progress` is as in `map`. Raises PalpateError, and changes nothing, if
    /// the method is `ekf`, the mapper continues a field, cells have their own prior means, fewer than three touches meet
    /// something, touches hardly predict each other or follow the arm's own motion, or some are no longer in memory.
    #[pyo3(signature = (progress = None))]
    fn choose_settings(
        &self,
        py: Python<'_>,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> Result<String> {
        let Some(initial) = &self.initial else {
            let why =
                "settings are not chosen for a field that is continued: it keeps its settings";
            return Err(PalpateError::new_err(why).into());
        };
        let log = {
            let state = self.state.take(py)?;
            let mapper = &state.borrow().mapper;
            if mapper.prior_n_per_m().is_some() || mapper.config().method != EstimatorKind::Map {
                let why =
                    "settings are chosen for the method `map` without prior means by cell only";
                return Err(PalpateError::new_err(why).into());
            }
            mapper.log_from(LogPosition::default())?
        };
        let (mut mapper, summary) =
            long(py, progress, |progress| self.chosen_for((initial, &log), progress))?;
        // What was learned meanwhile: most of it while others can use the mapper, the rest while they wait.
        let later = self.state.take(py)?.borrow().mapper.log_from(mapper.position())?;
        py.detach(|| mapper.catch_up(&later, || true))?;
        let state = self.state.take(py)?;
        let present = &mut state.borrow_mut().mapper;
        let last = present.log_from(mapper.position())?;
        py.detach(|| mapper.catch_up(&last, || true))?;
        mapper.go_on_after(&last);
        *present = mapper;
        Ok(summary)
    }

    /// A copy of the present field with its memory; later samples do not change it.
    fn field(&self, py: Python<'_>) -> Result<Field> {
        let saved = SavedField::of_mapper(&self.state.take(py)?.borrow().mapper);
        Field::of(py, saved)
    }

    /// Predicts the external torque along a motion: `path` is (P, n_joints) rad.
    ///
    /// Joints move linearly from point to point. During a touch, a path continues from the present contacts
    /// if no point of the arm is further than `start_cells` cells from its place at the start of the path; any
    /// other path starts free of contact. Contacts are computed at stops at most `resolution_cells` cells
    /// apart, and torques between them are interpolated; with 0, every point is a stop.
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

    /// A copy of the present field and contacts, to predict the torque of many motions.
    ///
    /// With `coarse`, each cluster of cells is one spring: this is several times faster, and torques differ
    /// by some percent.
    #[pyo3(signature = (coarse = false))]
    fn path_predictor(&self, py: Python<'_>, coarse: bool) -> PyResult<PathPredictor> {
        let weight = cluster_weight(coarse);
        let predictor = self.state.take(py)?.borrow().mapper.coarse_path_predictor(weight);
        Ok(PathPredictor::of(predictor))
    }

    /// Writes the field as .npz, never partially; without `memory`, mapping cannot be resumed from it.
    #[pyo3(signature = (path, memory = true))]
    fn save(&self, py: Python<'_>, path: PathBuf, memory: bool) -> Result<()> {
        let mut saved = SavedField::of_mapper(&self.state.take(py)?.borrow().mapper);
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
