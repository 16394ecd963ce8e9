//! A motion for identification, identification of an arm from free motion, and external torques of logs.

use palpate::{Differentiation, TorqueModel};
use palpate_learn::excite::ExciteConfig;
use palpate_work::identify::{self as identification, IdentifySettings};
use palpate_work::settings::Settings;
use palpate_work::settings::sections::RobotSettings;
use palpate_work::torque::{self, TorqueSettings};
use palpate_work::touches::{RecordedTouch, Touches};
use palpate_work::{Progress, WorkError, arm_file, excite as excitation};
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict, PyList};
use serde_json::json;

use crate::array::{flat, row, table, table_of};
use crate::data::python;
use crate::error::Result;
use crate::log::{opened, sources};
use crate::robot::{self, Robot};
use crate::settings;
use crate::watch::long;

/// Finds a motion that determines masses and friction of an arm for `identify`, as `palpate excite` does.
///
/// `start` are the joint positions at which the motion begins and ends, rad or m, without those of a gripper;
/// the middle of each range if left out. `duration` is in s, `speed` and `torque` are the largest shares of the
/// joints' limits, `ground_m` is the height above which the arm stays, m in the base frame, or None, `reach` is
/// the largest travel of a joint from its start, rad or m. `slow_down` slows the motion down by this factor.
/// Returns a dict: `joint_names`, `time` (T,) s, `q`, `velocity` and `acceleration` (T, n_joints) in rad or m, and s,
/// the keys of the command's JSON, such as `condition`, and `csv` and `yaml`, the contents of the files that the
/// command writes: a table, and a trajectory_msgs/JointTrajectory. Only the ground and the arm itself are known
/// as obstacles: play the motion slowly first.
///
/// Raises FileError if there is no such robot, or SettingsError if an argument is out of its range or no motion
/// keeps to the limits.
#[pyfunction]
#[pyo3(signature = (
    robot = None, *, start = None, duration = 20.0, rate_hz = 100.0, speed = 0.5, torque = 0.8, ground_m = 0.05,
    reach = 1.2, slow_down = 1.0, seed = 0, progress = None
))]
#[allow(clippy::too_many_arguments)] // they are keywords
pub(crate) fn excite<'py>(
    py: Python<'py>,
    robot: Option<&Bound<'py, PyAny>>,
    start: Option<&Bound<'py, PyAny>>,
    duration: f64,
    rate_hz: f64,
    speed: f64,
    torque: f64,
    ground_m: Option<f64>,
    reach: f64,
    slow_down: f64,
    seed: u64,
    progress: Option<&Bound<'py, PyAny>>,
) -> Result<Bound<'py, PyDict>> {
    let robot = robot::given(py, robot, &RobotSettings::default())?;
    let config = ExciteConfig {
        around: start.map(|start| row(start, "start", None)).transpose()?,
        duration_s: duration,
        rate_hz,
        speed_share: speed,
        torque_share: torque,
        ground_m,
        reach,
        seed,
        ..ExciteConfig::default()
    };
    let (arm, found) =
        long(py, progress, |progress| excitation::run(robot.arm, config, slow_down, progress))?;
    let robot = &arm.robot;
    let dict = python(py, &excitation::json(&found))?.cast_into::<PyDict>().map_err(PyErr::from)?;
    dict.set_item("joint_names", robot.joint_names().collect::<Vec<_>>())?;
    dict.set_item("csv", excitation::table(robot, &found))?;
    dict.set_item("yaml", excitation::trajectory(robot, &found))?;
    for (column, key) in ["q", "velocity", "acceleration"].into_iter().enumerate() {
        let rows = found.points.iter().map(|point| &point[column][..]);
        dict.set_item(key, table_of(py, rows, robot.n_joints()))?;
    }
    dict.set_item("time", flat(py, found.times_s))?;
    Ok(dict)
}

/// Finds payload, friction, bias and delay of an arm from logs of free motion, as `palpate identify` does.
///
/// `log` is a path, a `Log`, a `Touch`, or several. `tool_link` names the link in whose frame the payload
/// is given, that of the last joint if left out. With `currents`, or if the names of columns show it, the
/// torques are motor currents. Returns a dict like the command's JSON: `payload`, `joints`, `bodies` and
/// `delay_s` with values and standard deviations; `touched`, the share of the samples that is left out
/// because of contact; `read_times`, how far stamps are from the times at which the joints were read;
/// `held_out` with the residual torques, N·m; `misfit`, what is wrong if these are too large, or None;
/// `text`, the content of the file for `Robot(..., arm="arm.toml")` and the command's --arm.
///
/// Raises SettingsError, FileError or PalpateError if the logs cannot be used.
#[pyfunction]
#[pyo3(signature = (log, robot = None, *, tool_link = None, currents = false, settings = None, progress = None, **sections))]
#[allow(clippy::too_many_arguments)] // they are keywords
pub(crate) fn identify<'py>(
    py: Python<'py>,
    log: &Bound<'py, PyAny>,
    robot: Option<&Bound<'py, PyAny>>,
    tool_link: Option<String>,
    currents: bool,
    settings: Option<&Bound<'py, PyAny>>,
    progress: Option<&Bound<'py, PyAny>>,
    sections: Option<&Bound<'py, PyDict>>,
) -> Result<Bound<'py, PyAny>> {
    let mut settings = settings::read(settings, sections)?;
    let robot = robot::given(py, robot, &settings.robot)?;
    let sources = sources(log)?;
    let (found, torques) = long(py, progress, |progress| -> Result<_, WorkError> {
        let mut touches = opened(sources, &settings.log)?;
        if currents {
            touches.treat_as_currents();
        }
        let (recorded, currents) = read(touches, (&robot, &mut settings), None, progress)?;
        let strict = settings.log.strict.unwrap_or_default();
        let wanted = IdentifySettings { tool_link, currents, strict };
        let torques = settings.config()?.touch;
        let found = identification::run(&robot.arm, &recorded, &torques, &wanted, progress)?;
        Ok((found, torques))
    })?;
    let text = arm_file::text(&robot.arm.robot, &found.model, &torques, "");
    let mut json = identification::json(&found);
    json["text"] = json!(text);
    Ok(python(py, &json)?)
}

/// External torques of logs with their standard deviations, as `palpate torque` writes them.
///
/// `log` is a path, a `Log`, a `Touch`, or several. `robot` is an identified arm, `Robot(..., arm="arm.toml")`,
/// or any other arm, whose standard deviations are then a guess. Returns a dict for each touch: `name`,
/// `time` (T,) s or None, `q` (T, n_joints) rad in the robot's order, `torque` and `std` (T, n_joints) N·m,
/// `statistic` (T,): the largest |torque| / std over the joints; `threshold`, which the statistic of
/// contact-free motion exceeds `false_alarms_per_hour` times an hour, None if it is not known; and `wrench`
/// (T, 6), with `wrench_link`: the force, N, and the moment, N·m, at the origin of this link that explain the
/// torques best, along the axes of the base; else None. The threshold is determined from `free`, logs of
/// contact-free motion, or from the motion that was held out in identification.
///
/// Raises SettingsError, FileError or TouchError.
#[pyfunction]
#[pyo3(signature = (
    log, robot = None, *, causal = false, bandwidth_hz = None, free = None, false_alarms_per_hour = 1.0,
    wrench_link = None, settings = None, progress = None, **sections
))]
#[allow(clippy::too_many_arguments)] // they are keywords
pub(crate) fn external_torques<'py>(
    py: Python<'py>,
    log: &Bound<'py, PyAny>,
    robot: Option<&Bound<'py, PyAny>>,
    causal: bool,
    bandwidth_hz: Option<f64>,
    free: Option<&Bound<'py, PyAny>>,
    false_alarms_per_hour: f64,
    wrench_link: Option<&str>,
    settings: Option<&Bound<'py, PyAny>>,
    progress: Option<&Bound<'py, PyAny>>,
    sections: Option<&Bound<'py, PyDict>>,
) -> Result<Bound<'py, PyList>> {
    let mut settings = settings::read(settings, sections)?;
    let robot = robot::given(py, robot, &settings.robot)?;
    settings.robot.arm.clone_from(&robot.settings.arm);
    let (log, free) = (sources(log)?, free.map(sources).transpose()?);
    let differentiation = if causal { Differentiation::Causal } else { Differentiation::Centred };
    let (found, threshold) = long(py, progress, |progress| -> Result<_, WorkError> {
        let model = arm_file::or_urdf(&robot.settings, &robot.arm.robot, progress)?;
        let of_model = model.clone().for_differentiation(differentiation);
        let link = |name| torque::wrench_link(&robot.arm.robot, name);
        let how = TorqueSettings {
            bandwidth_hz,
            tare_frames: settings.touch.first_frames(),
            wrench_link: wrench_link.map(link).transpose()?,
        };
        // Sign and gravity are found for each of the two separately, as by the command.
        let torques = |sources, mut settings: Settings| {
            let touches = opened(sources, &settings.log)?;
            let model = Some((model.clone(), differentiation));
            let (recorded, _) = read(touches, (&robot, &mut settings), model, progress)?;
            torque::torques(&robot.arm, &recorded, &how, progress)
        };
        let free = free.map(|free| torques(free, settings.clone())).transpose()?;
        let (threshold, from) =
            torque::threshold(&of_model, free.as_deref(), false_alarms_per_hour)?;
        let found = torques(log, settings)?;
        let joints: Vec<String> = robot.arm.robot.joint_names().map(str::to_owned).collect();
        torque::judge_threshold(&found, &joints, (threshold, from), &how, progress);
        Ok((found, (from != torque::ThresholdSource::Guess).then_some(threshold)))
    })?;
    let list = PyList::empty(py);
    for touch in &found {
        let dict = PyDict::new(py);
        let frames = &touch.frames;
        let times: Option<Vec<f64>> = frames.iter().map(|frame| frame.time_s).collect();
        dict.set_item("name", &touch.name)?;
        dict.set_item("time", times.map(|times| flat(py, times)))?;
        let n = robot.arm.robot.n_joints();
        dict.set_item("q", table_of(py, frames.iter().map(|frame| frame.q.as_slice()), n))?;
        let torques = frames.iter().map(|frame| frame.external.torque.as_slice());
        dict.set_item("torque", table_of(py, torques, n))?;
        let stds = frames.iter().map(|frame| frame.external.std.as_slice());
        dict.set_item("std", table_of(py, stds, n))?;
        let statistics: Vec<f64> = frames.iter().map(|frame| frame.statistic).collect();
        dict.set_item("statistic", flat(py, statistics))?;
        dict.set_item("threshold", threshold)?;
        let wrenches = frames.iter().filter_map(|frame| frame.wrench);
        let wrenches = wrench_link.map(|_| {
            table(py, wrenches.flat_map(|wrench| <[f64; 6]>::from(wrench.in_base)).collect(), 6)
        });
        dict.set_item("wrench", wrenches)?;
        list.append(dict)?;
    }
    Ok(list)
}

/// Reads all touches of logs, with joints in the robot's order. With a model, torques are external torques; without,
/// motor torques or currents; also returns whether they are currents.
fn read(
    mut touches: Touches,
    (robot, settings): (&Robot, &mut Settings),
    model: Option<(TorqueModel, Differentiation)>,
    progress: &dyn Progress,
) -> Result<(Vec<RecordedTouch>, bool), WorkError> {
    touches.angle_unit(&robot.arm, settings, progress)?;
    touches.decide_convention(&robot.arm, model, settings, progress)?;
    let currents = touches.are_currents();
    Ok((touches.read_for(&robot.arm, settings, progress)?, currents))
}
