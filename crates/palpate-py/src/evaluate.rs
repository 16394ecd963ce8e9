//! Comparison of methods on held-out touches, and choice of settings by cross-validation.

use palpate_learn::bands::Band;
use palpate_learn::evaluation::{Evaluation, HeldOutTouch, MethodPrediction, MethodSummary};
use palpate_learn::method::Method;
use palpate_learn::torque_errors::TorqueErrors;
use palpate_work::WorkError;
use palpate_work::elastic::replace_elastic_by_map;
use palpate_work::evaluate::{
    self as evaluation, EvaluationJob, NoStore, configs, method_of, methods_to_compare,
};
use palpate_work::touches::IfUndecided;
use palpate_work::tune::{Tune, Tuning, given as given_settings, trials, tuned_settings};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict};
use serde_json::{Value, json};

use crate::array::{flat, table_of};
use crate::data::{given, of_python, python};
use crate::elastic::{ObjectArguments, seen_object};
use crate::error::Result;
use crate::log::{opened, sources};
use crate::tracked_logs::TrackedLogs;
use crate::watch::long;
use crate::{robot, settings};

/// Compares methods on held-out touches, as `palpate evaluate` does.
///
/// `methods` are some of elastic, map, ekf, mlp, gp, knn, uniform and zero, all if left out; zero is
/// always added. elastic needs a `cloud` of the object, with `colours`, `viewpoint`, `object_kind` and
/// `root` as for `map_elastic`. The touches are divided into `folds`, one for each touch if left out;
/// those of a fold are predicted from all others. With `test`, only the touches of these names are
/// predicted, from all others. `truth` compares with true torques.
///
/// `tune` chooses settings in every fold: "quick", also if left out, those of map that are not given,
/// among few candidates; True those of map and ekf, among many; False none. `share` is a number from 0
/// and the number of shares: only this share of the folds is computed, and the result is a
/// `palpate.results.Share`. `reuse` is a name for logs and robot in their present state: data that was
/// read by the last call with the same name is used again, if the settings allow it.
#[pyfunction]
#[pyo3(signature = (
    logs, robot = None, *, methods = None, cloud = None, colours = None, viewpoint = None, object_kind = None,
    root = None, folds = None, test = None, truth = false, tune = None, share = None, reuse = None, settings = None, progress = None, **sections
))]
#[allow(clippy::too_many_arguments)] // they are keywords
pub(crate) fn evaluate<'py>(
    py: Python<'py>,
    logs: &Bound<'py, PyAny>,
    robot: Option<&Bound<'py, PyAny>>,
    methods: Option<Vec<String>>,
    cloud: Option<&Bound<'py, PyAny>>,
    colours: Option<&Bound<'py, PyAny>>,
    viewpoint: Option<&Bound<'py, PyAny>>,
    object_kind: Option<&str>,
    root: Option<&Bound<'py, PyAny>>,
    folds: Option<u32>,
    test: Option<Vec<String>>,
    truth: bool,
    tune: Option<&Bound<'py, PyAny>>,
    share: Option<(usize, usize)>,
    reuse: Option<String>,
    settings: Option<&Bound<'py, PyAny>>,
    progress: Option<&Bound<'py, PyAny>>,
    sections: Option<&Bound<'py, PyDict>>,
) -> Result<Bound<'py, PyAny>> {
    let mut settings = settings::read(settings, sections)?;
    let robot = robot::given(py, robot, &settings.robot)?;
    settings.robot.arm.clone_from(&robot.settings.arm);
    let sources = sources(logs)?;
    let mut chosen = Vec::new();
    for name in methods.iter().flatten() {
        chosen.push(method_of(name).map_err(|there_are| {
            PyValueError::new_err(format!("`methods` names {name:?}; {there_are}"))
        })?);
    }
    let object = ObjectArguments { colours, viewpoint, kind: object_kind, root };
    if cloud.is_none() && object.is_given() {
        let message = "`colours`, `viewpoint`, `object_kind` and `root` belong to a `cloud`, which is not given";
        return Err(PyValueError::new_err(message).into());
    }
    let tune = tune.map_or(Ok(Tune::default()), thoroughness)?;
    let cloud = cloud.map(|cloud| seen_object(py, cloud, object));
    let cloud = cloud.transpose()?;
    replace_elastic_by_map(&mut settings, cloud.is_some()).map_err(WorkError::from)?;
    let mut methods = methods_to_compare(&chosen, cloud.is_some())?;
    if !methods.contains(&Method::Zero) {
        methods.push(Method::Zero); // every table compares with it
    }
    let evaluated = long(py, progress, |progress| {
        let arm = &robot.arm;
        let named = (truth, reuse.as_deref());
        let logs = TrackedLogs::of(sources, &mut settings, arm, named, progress)?;
        let TrackedLogs { recorded, touches, .. } = &*logs;
        let folds = evaluation::folds(touches, folds, test.as_deref().unwrap_or_default())?;
        let work = EvaluationJob {
            arm,
            recorded,
            touches,
            todo: evaluation::share(folds.len(), share.unwrap_or((0, 1)))?,
            folds,
            methods,
            estimators: configs(&settings)?,
            tune,
            given: given_settings(&settings),
            truth,
            bodies: cloud.map(|object| object.bodies(progress)).transpose()?.unwrap_or_default(),
            tracked: Some(logs.tracked()),
        };
        work.evaluate(&NoStore, progress)
    })?;
    let result = result(py, &evaluated.evaluation)?;
    let tuned = evaluated.tuned.map(|folds| {
        let fold = |[map, ekf]: &[_; 2]| json!({ "map": map, "ekf": ekf });
        folds.iter().map(fold).collect::<Vec<_>>()
    });
    result.set_item("tuned", python(py, &json!(tuned))?)?;
    if share.is_some_and(|(_, of)| of > 1) {
        result.set_item("bands", bands(py, &evaluated.evaluation)?)?;
    }
    Ok(result.into_any())
}

/// Reads the argument `tune`: a bool, or "quick".
fn thoroughness(tune: &Bound<'_, PyAny>) -> PyResult<Tune> {
    if let Ok(tune) = tune.extract::<bool>() {
        return Ok(if tune { Tune::Thorough } else { Tune::Off });
    }
    match tune.extract::<&str>() {
        Ok("quick") => Ok(Tune::Quick),
        _ => Err(PyValueError::new_err(format!("`tune` is {tune}; wanted a bool or \"quick\""))),
    }
}

/// A band, and [`Band::errors_n_m`], which are not serialized with it.
type BandWithErrors = (Band, Vec<f64>);

/// The row of a method in Table I, from its errors and `bands` on the touches as `evaluate` returns them.
#[pyfunction]
pub(crate) fn summarised<'py>(
    py: Python<'py>,
    name: &str,
    errors: &Bound<'py, PyAny>,
    bands: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let errors: Vec<Option<TorqueErrors>> = of_python(errors)?;
    let errors: Vec<TorqueErrors> = errors.into_iter().flatten().collect();
    let touches: Vec<[Option<BandWithErrors>; 2]> = of_python(bands)?;
    let [mut own, mut of_other_objects] = [Vec::new(), Vec::new()];
    for kinds in touches {
        for (kind, all) in kinds.into_iter().zip([&mut own, &mut of_other_objects]) {
            all.extend(kind.map(|(band, errors_n_m)| Band { errors_n_m, ..band }));
        }
    }
    let [own, of_other_objects] =
        [&own, &of_other_objects].map(|all| all.iter().collect::<Vec<_>>());
    python(py, &json!(MethodSummary::of(name, &errors, [&own, &of_other_objects])))
}

/// The bands of each method on each touch, for `summarised`: calibrated on its own touches, and on other objects.
fn bands<'py>(py: Python<'py>, evaluation: &Evaluation) -> PyResult<Bound<'py, PyAny>> {
    let with_errors = |band: &Option<Band>| band.as_ref().map(|own| json!([own, own.errors_n_m]));
    let method = |own: &MethodPrediction| {
        let both = [&own.band, &own.band_of_other_objects].map(with_errors);
        (own.method.clone(), json!(both))
    };
    let touch = |touch: &HeldOutTouch| touch.predictions.iter().map(method).collect::<Value>();
    python(py, &evaluation.touches.iter().map(touch).collect())
}

/// An evaluation as plain Python data, with torques as arrays.
fn result<'py>(py: Python<'py>, evaluation: &Evaluation) -> PyResult<Bound<'py, PyDict>> {
    let result = PyDict::new(py);
    result.set_item("methods", python(py, &json!(evaluation.methods))?)?;
    result.set_item("against", &evaluation.against)?;
    result.set_item("joint_names", &evaluation.joint_names)?;
    let joints = evaluation.joint_names.len();
    let touches = evaluation.touches.iter().map(|touch| left_out(py, touch, joints));
    result.set_item("touches", touches.collect::<PyResult<Vec<_>>>()?)?;
    Ok(result)
}

/// A held-out touch as a dict.
fn left_out<'py>(
    py: Python<'py>,
    touch: &HeldOutTouch,
    joints: usize,
) -> PyResult<Bound<'py, PyDict>> {
    let rows = |torques: &[Vec<f64>]| table_of(py, torques.iter().map(Vec::as_slice), joints);
    let dict = PyDict::new(py);
    dict.set_item("name", &touch.name)?;
    dict.set_item("fold", touch.fold)?;
    dict.set_item("time", flat(py, touch.time_s.clone()))?;
    dict.set_item("contacts", flat(py, touch.contacts.clone()))?;
    dict.set_item("known", flat(py, touch.known.clone()))?;
    dict.set_item("q", rows(&touch.q))?;
    dict.set_item("external", rows(&touch.external))?;
    let (predicted, errors) = (PyDict::new(py), PyDict::new(py));
    for prediction in &touch.predictions {
        predicted.set_item(&prediction.method, rows(&prediction.predicted))?;
        errors.set_item(&prediction.method, python(py, &json!(prediction.errors))?)?;
    }
    dict.set_item("predicted", predicted)?;
    dict.set_item("errors", errors)?;
    Ok(dict)
}

/// Chooses settings by cross-validation on at least three touches, as `palpate tune` does.
///
/// `candidates` is the number of candidates, 2 to 1000, 24 if left out (12 for ekf); `quick` uses only
/// few, as `palpate map` does. Other calls take the `settings` of the result.
#[pyfunction]
#[pyo3(signature = (
    logs, robot = None, *, candidates = None, quick = false, settings = None, progress = None, **sections
))]
#[allow(clippy::too_many_arguments)] // they are keywords
pub(crate) fn tune<'py>(
    py: Python<'py>,
    logs: &Bound<'py, PyAny>,
    robot: Option<&Bound<'py, PyAny>>,
    candidates: Option<u32>,
    quick: bool,
    settings: Option<&Bound<'py, PyAny>>,
    progress: Option<&Bound<'py, PyAny>>,
    sections: Option<&Bound<'py, PyDict>>,
) -> Result<Bound<'py, PyAny>> {
    if candidates.is_some_and(|n| !(2..=1000).contains(&n)) {
        return Err(PyValueError::new_err("`candidates` must be from 2 to 1000").into());
    }
    if quick && candidates.is_some() {
        return Err(PyValueError::new_err(
            "`quick` has its own candidates: leave out `candidates` or `quick`",
        )
        .into());
    }
    let mut settings = settings::read(settings, sections)?;
    let robot = robot::given(py, robot, &settings.robot)?;
    settings.robot.arm.clone_from(&robot.settings.arm);
    let sources = sources(logs)?;
    let tuned = long(py, progress, |progress| -> Result<_, WorkError> {
        let arm = &robot.arm;
        let mut touches = opened(sources, &settings.log)?;
        touches.angle_unit(arm, &mut settings, progress)?;
        touches.prepare_torques(arm, &mut settings, IfUndecided::Refuse, progress)?;
        let (recorded, touches) = evaluation::read(touches, (arm, &settings), false, progress)?;
        let config = settings.config()?;
        let tuning = Tuning { arm, recorded: &recorded, touches: &touches, config: &config };
        if quick {
            tuning.quick(given_settings(&settings), progress)
        } else {
            tuning.thorough(candidates, progress)
        }
    })?;
    let chosen = tuned_settings(&tuned, &settings);
    let (toml, trials) = (chosen.template()?, trials(&tuned));
    let sections = given(json!(chosen));
    Ok(python(py, &json!({ "settings": sections, "toml": toml, "trials": trials }))?)
}
