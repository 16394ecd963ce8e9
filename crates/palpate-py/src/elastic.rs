//! Fields with an elastic body from a cloud.

use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::Point3;
use palpate::unstable::ElasticBody;
use palpate::{EstimatorKind, Mapper};
use palpate_io::cloud::Cloud;
use palpate_learn::body::{ObjectHints, ObjectKind};
use palpate_work::elastic::{CloudWithViewpoint, bodies, learn_body};
use palpate_work::learn::learn;
use palpate_work::settings::SettingsError;
use palpate_work::touches::IfUndecided;
use palpate_work::{Progress, WorkError};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict, PyList, PyTuple};

use crate::array;
use crate::data::named;
use crate::error::Result;
use crate::extrapolate;
use crate::field::Field;
use crate::log::{opened, sources};
use crate::watch::long;
use crate::{robot, settings};

/// Arguments beside the `cloud` of an object: colours of points given as arrays, positions of the cameras, kind
/// and root of the object.
#[derive(Default)]
pub(crate) struct ObjectArguments<'a, 'py> {
    pub colours: Option<&'a Bound<'py, PyAny>>,
    pub viewpoint: Option<&'a Bound<'py, PyAny>>,
    pub kind: Option<&'a str>,
    pub root: Option<&'a Bound<'py, PyAny>>,
}

impl ObjectArguments<'_, '_> {
    pub(crate) fn is_given(&self) -> bool {
        let Self { colours, viewpoint, kind, root } = self;
        colours.is_some() || viewpoint.is_some() || kind.is_some() || root.is_some()
    }
}

/// One or several points, (3,) or (N, 3), finite, m.
fn places(given: Option<&Bound<'_, PyAny>>, name: &str) -> Result<Vec<Point3<f64>>> {
    let Some(given) = given else { return Ok(Vec::new()) };
    let places = array::places(given, name)?;
    if let Some(place) = places.iter().flatten().find(|along| !along.is_finite()) {
        let message = format!("`{name}` holds {place}; wanted finite numbers, m");
        return Err(PyValueError::new_err(message).into());
    }
    Ok(places.into_iter().map(Point3::from).collect())
}

/// The clouds, one or a list, of paths or arrays; each with its name for error messages.
fn clouds(
    py: Python<'_>,
    cloud: &Bound<'_, PyAny>,
    colours: Option<&Bound<'_, PyAny>>,
) -> Result<Vec<(PathBuf, Cloud)>> {
    let is_cloud = |one: &Bound<'_, PyAny>| {
        let of_points = one.getattr("ndim").and_then(|ndim| ndim.extract::<usize>());
        one.extract::<PathBuf>().is_ok() || of_points.is_ok_and(|ndim| ndim == 2)
    };
    let is_several = cloud.is_instance_of::<PyList>() || cloud.is_instance_of::<PyTuple>();
    let several: Option<Vec<Bound<'_, PyAny>>> = is_several.then(|| cloud.extract()).transpose()?;
    let Some(several) = several.filter(|several| several.first().is_some_and(is_cloud)) else {
        return Ok(vec![extrapolate::read(py, cloud, colours)?]);
    };
    let colours: Vec<Option<Bound<'_, PyAny>>> = match colours {
        None => vec![None; several.len()],
        Some(colours) => colours.extract::<Vec<_>>()?.into_iter().map(Some).collect(),
    };
    if colours.len() != several.len() {
        let (n, found) = (several.len(), colours.len());
        let message =
            format!("`cloud` lists {n} clouds and `colours` {found}; wanted one for each");
        return Err(PyValueError::new_err(message).into());
    }
    let pairs = several.iter().zip(&colours);
    pairs.map(|(cloud, colours)| extrapolate::read(py, cloud, colours.as_ref())).collect()
}

/// Clouds of an object, and hints about it.
pub(crate) struct SeenObject {
    clouds: Vec<CloudWithViewpoint>,
    hints: ObjectHints,
    name: String,
}

impl SeenObject {
    /// The elastic bodies that fit the clouds; reports what was found as notes.
    pub(crate) fn bodies(
        &self,
        progress: &dyn Progress,
    ) -> std::result::Result<Vec<Arc<ElasticBody>>, WorkError> {
        bodies(&self.clouds, &self.hints, &self.name, progress)
    }
}

/// Reads the clouds of an object and its hints.
pub(crate) fn seen_object(
    py: Python<'_>,
    cloud: &Bound<'_, PyAny>,
    ObjectArguments { colours, viewpoint, kind, root }: ObjectArguments<'_, '_>,
) -> Result<SeenObject> {
    let wanted = format!("one of {:?}", ObjectKind::WORDS);
    let kind = kind.map(|word| named("object_kind", word, &wanted)).transpose()?;
    let hints = ObjectHints { kind, roots_m: places(root, "root")? };
    let viewpoints = places(viewpoint, "viewpoint")?;
    let (names, clouds): (Vec<PathBuf>, Vec<Cloud>) =
        clouds(py, cloud, colours)?.into_iter().unzip();
    if !viewpoints.is_empty() && viewpoints.len() != clouds.len() {
        let (n, found) = (clouds.len(), viewpoints.len());
        let message = format!("`viewpoint` holds {found} places; wanted one for each cloud: {n}");
        return Err(PyValueError::new_err(message).into());
    }
    let viewpoints = viewpoints.into_iter().map(Some).chain(std::iter::repeat(None));
    let clouds: Vec<CloudWithViewpoint> = clouds.into_iter().zip(viewpoints).collect();
    let names: Vec<String> = names.iter().map(|name| name.display().to_string()).collect();
    Ok(SeenObject { clouds, hints, name: names.join("`, `") })
}

/// Learns a field with an elastic body from a cloud, as `palpate map --cloud` does.
///
/// `cloud` is the path of a PLY or PCD file with colours, or points (N, 3) m, world frame, with
/// `colours` (N, 3) from 0 to 255. `viewpoint` is the position of the camera, (3,) m, estimated from the
/// cloud if left out. `object_kind` is "plant" (stems, branches, leaves) or "cushion" (any other soft
/// object), also found from the cloud if left out. `root` is the point where a plant is fixed, (3,) m, or
/// one for each tree, (R, 3); if left out, where it meets the ground. Clouds of several cameras are a list
/// of paths, or lists of arrays for `cloud` and `colours`, with `viewpoint` (C, 3).
///
/// If `logs` is None, the body has the typical stiffness of other plants. A cloud in which nothing
/// stands above its lowest point gives a field without a body.
#[pyfunction]
#[pyo3(signature = (
    logs, cloud, colours = None, robot = None, *, viewpoint = None, object_kind = None, root = None,
    settings = None, progress = None, **sections
))]
#[allow(clippy::too_many_arguments)] // they are keywords
pub(crate) fn map_elastic(
    py: Python<'_>,
    logs: Option<&Bound<'_, PyAny>>,
    cloud: &Bound<'_, PyAny>,
    colours: Option<&Bound<'_, PyAny>>,
    robot: Option<&Bound<'_, PyAny>>,
    viewpoint: Option<&Bound<'_, PyAny>>,
    object_kind: Option<&str>,
    root: Option<&Bound<'_, PyAny>>,
    settings: Option<&Bound<'_, PyAny>>,
    progress: Option<&Bound<'_, PyAny>>,
    sections: Option<&Bound<'_, PyDict>>,
) -> Result<Field> {
    let mut settings = settings::read(settings, sections)?;
    match settings.estimator.estimator {
        Some(EstimatorKind::Elastic) | None => {}
        Some(other) => {
            let message = format!(
                "`estimator` is {:?}; map_elastic needs the estimator \"elastic\"",
                other.name()
            );
            return Err(PyValueError::new_err(message).into());
        }
    }
    settings.estimator.estimator = Some(EstimatorKind::Elastic);
    settings.config()?;
    let robot = robot::given(py, robot, &settings.robot)?;
    let sources = logs.map(sources).transpose()?.unwrap_or_default();
    let object =
        seen_object(py, cloud, ObjectArguments { colours, viewpoint, kind: object_kind, root })?;
    let saved = long(py, progress, |progress| -> Result<_, WorkError> {
        let bodies = object.bodies(progress)?;
        let mut touches = opened(sources, &settings.log)?;
        touches.angle_unit(&robot.arm, &mut settings, progress)?;
        let arm = Arc::clone(&robot.arm);
        settings.robot.arm.clone_from(&robot.settings.arm);
        touches.prepare_torques(&arm, &mut settings, IfUndecided::Refuse, progress)?;
        let config = settings.config()?;
        let mut mapper = Mapper::new(arm, config).map_err(SettingsError::value)?;
        let lattice = mapper.config().lattice.clone();
        let mut touches = touches.for_arm(&robot.arm, &settings.log, lattice)?;
        let mut samples = Vec::new();
        let record = Some(&mut samples);
        learn(&mut mapper, &mut touches, &mut |_, _, _| (), record, progress)?;
        learn_body(&mapper, &bodies, samples, progress)
    })?;
    Field::of(py, saved)
}
