//! The robot arm.

use std::path::PathBuf;
use std::sync::Arc;

use numpy::{PyArray1, PyArray2};
use palpate::Arm;
use palpate_work::settings::Settings;
use palpate_work::settings::sections::RobotSettings;
use palpate_work::{Progress, WorkError, robot};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict};
use serde_json::json;

use crate::array::{flat, row, table};
use crate::data;
use crate::error::Result;
use crate::watch::unshown;

/// A robot arm with the surfaces of its links.
///
/// `name_or_urdf` is the path of a URDF or the name of a built-in robot, `kinova_gen3` if left out;
/// `packages` are folders of ROS packages for `package://` paths of meshes. `options` are the other
/// keys of `palpate.settings.RobotSettings`, such as a payload. Meshes are converted to grids of signed
/// distances at the first use; these are cached.
///
/// Raises FileError if there is no such robot or its files are broken.
#[pyclass(frozen, module = "palpate")]
#[derive(Clone)]
pub(crate) struct Robot {
    pub(crate) arm: Arc<Arm>,
    pub(crate) settings: RobotSettings,
    /// Files that it was read from: URDF and meshes, unless it is built in, and the arm file, if any.
    #[pyo3(get)]
    pub(crate) files: Vec<PathBuf>,
}

/// The robot of an argument: a [`Robot`], a name, or a path; for `None`, the one in the settings.
pub(crate) fn given(
    py: Python<'_>,
    any: Option<&Bound<'_, PyAny>>,
    settings: &RobotSettings,
) -> Result<Robot> {
    let mut settings = settings.clone();
    if let Some(any) = any {
        if let Ok(robot) = any.cast::<Robot>() {
            return Ok(robot.get().clone());
        }
        settings.robot = Some(any.extract::<PathBuf>()?.to_string_lossy().into_owned());
    }
    loaded(py, settings)
}

/// Loads the robot of the settings.
fn loaded(py: Python<'_>, settings: RobotSettings) -> Result<Robot> {
    let loaded = unshown(py, |progress| {
        let loaded = robot::load_with_report(&settings)?;
        loaded.warnings.iter().for_each(|warning| progress.warn(warning));
        Ok::<_, WorkError>(loaded)
    })?;
    let mut files: Vec<PathBuf> = loaded.urdf.into_iter().collect();
    files.extend(loaded.links.into_iter().flat_map(|link| link.meshes));
    files.extend(settings.arm.clone());
    Ok(Robot { arm: Arc::new(loaded.arm), settings, files })
}

#[pymethods]
impl Robot {
    #[new]
    #[pyo3(signature = (name_or_urdf = None, packages = None, **options))]
    fn new(
        py: Python<'_>,
        name_or_urdf: Option<PathBuf>,
        packages: Option<Vec<PathBuf>>,
        options: Option<&Bound<'_, PyDict>>,
    ) -> Result<Self> {
        let mut settings = crate::settings::section("robot", options)?.robot;
        if let Some(name) = name_or_urdf {
            settings.robot = Some(name.to_string_lossy().into_owned());
        }
        settings.package_path = packages.or(settings.package_path);
        Settings::from(settings.clone()).check()?;
        loaded(py, settings)
    }

    /// Name of the robot in its URDF.
    #[getter]
    fn name(&self) -> &str {
        self.arm.robot.name()
    }

    /// Names of the moving joints, in the order of all joint positions and torques.
    #[getter]
    fn joint_names(&self) -> Vec<&str> {
        self.arm.robot.joint_names().collect()
    }

    /// Names of the links.
    #[getter]
    fn link_names(&self) -> Vec<&str> {
        self.arm.robot.links().iter().map(|link| &*link.name).collect()
    }

    /// Number of moving joints.
    #[getter]
    fn n_joints(&self) -> usize {
        self.arm.robot.n_joints()
    }

    /// Lowest and highest position of each joint, (n_joints, 2), rad (m where prismatic); infinite if unlimited.
    #[getter]
    fn limits(&self, py: Python<'_>) -> Py<PyArray2<f64>> {
        let unlimited = [f64::NEG_INFINITY, f64::INFINITY];
        let joints = self.arm.robot.joints().iter();
        table(py, joints.flat_map(|joint| joint.range.unwrap_or(unlimited)).collect(), 2)
    }

    /// Torque of gravity on the joints at positions `q` (n_joints,) rad: (n_joints,) N·m.
    fn gravity(&self, py: Python<'_>, q: &Bound<'_, PyAny>) -> Result<Py<PyArray1<f64>>> {
        let robot = &self.arm.robot;
        let q = row(q, "q", Some(robot.n_joints()))?;
        let poses = robot.forward(&q)?;
        Ok(flat(py, robot.gravity_torque(&poses).as_slice().to_vec()))
    }

    /// Pose of a link at positions `q` (n_joints,) rad: `world_from_link`, (4, 4), m.
    fn forward(
        &self,
        py: Python<'_>,
        q: &Bound<'_, PyAny>,
        link: &str,
    ) -> Result<Py<PyArray2<f64>>> {
        let robot = &self.arm.robot;
        let id = robot.link_id(link).ok_or_else(|| {
            let names = self.link_names().join(", ");
            PyValueError::new_err(format!("the robot has no link `{link}`; there are {names}"))
        })?;
        let q = row(q, "q", Some(robot.n_joints()))?;
        let poses = robot.forward(&q)?;
        let pose = poses.world_from_link[id.index()].to_homogeneous().transpose();
        Ok(table(py, pose.as_slice().to_vec(), 4))
    }

    fn __repr__(&self) -> String {
        format!("Robot({:?}, {} joints)", self.arm.robot.name(), self.arm.robot.n_joints())
    }

    fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<((), Bound<'py, PyAny>)> {
        Ok(((), data::python(py, &data::given(json!(self.settings)))?))
    }
}
