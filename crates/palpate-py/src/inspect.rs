//! Reports the content of a log, and what looks wrong with it.

use palpate_work::inspect::log;
use palpate_work::settings::Settings;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict};
use serde_json::json;

use crate::data::python;
use crate::error::Result;
use crate::log::{Source, opened, sources};
use crate::watch::long;
use crate::{robot, settings};

/// Reports the content of a log and what looks wrong with it, as `palpate inspect` does.
///
/// `log` is a path, a `Log`, a `Touch`, or several, which are read as one. Torques are compared with
/// the gravity of the robot. Contacts are computed as by `Mapper.map`, with lattice and contact model of
/// the settings, such as `lattice=Lattice(...)`. `findings` have a `level` (note, warning or error), `what`
/// was seen and the `remedy`, errors first. `log` has the figures: units, sign and gravity of the log
/// (`reading`), the cells touched (`touched`), and figures of every touch, N·m, s, rad; it is None if
/// nothing can be read.
///
/// Raises SettingsError or FileError; defects of the log itself are findings.
#[pyfunction]
#[pyo3(signature = (log, robot = None, *, settings = None, progress = None, **sections))]
pub(crate) fn inspect<'py>(
    py: Python<'py>,
    log: &Bound<'py, PyAny>,
    robot: Option<&Bound<'py, PyAny>>,
    settings: Option<&Bound<'py, PyAny>>,
    progress: Option<&Bound<'py, PyAny>>,
    sections: Option<&Bound<'py, PyDict>>,
) -> Result<Bound<'py, PyAny>> {
    let mut settings = settings::read(settings, sections)?;
    let robot = robot::given(py, robot, &settings.robot)?;
    let sources = sources(log)?;
    for source in &sources {
        if let Source::Log(_, own) = source {
            settings = Settings::from(own.clone()).over(settings);
        }
    }
    let (log, findings) = long(py, progress, |progress| {
        let config = settings.config()?;
        let touches = opened(sources, &settings.log);
        log::inspect(touches, (&settings, &config), (&robot.arm, progress))
    })?;
    Ok(python(py, &json!({ "log": log, "findings": findings }))?)
}
