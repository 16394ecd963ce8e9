//! Fields with an elastic body from a cloud.

use std::sync::Arc;

use nalgebra::Point3;
use palpate::unstable::ElasticBody;
use palpate::{EstimatorKind, Mapper};
use palpate_learn::body::ObjectKind;
use palpate_work::elastic::{bodies, learn_body};
use palpate_work::learn::learn;
use palpate_work::settings::SettingsError;
use palpate_work::{Progress, WorkError};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict};
use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::{Error as ValueError, StrDeserializer};

use crate::error::Result;
use crate::extrapolate;
use crate::field::Field;
use crate::log::{opened, sources};
use crate::watch::long;
use crate::{robot, settings};

/// A cloud as an argument: a path, or points, with their colours, the place of the camera, and the kind of the
/// object.
pub(crate) type CloudArgument<'a, 'py> =
    (&'a Bound<'py, PyAny>, Option<&'a Bound<'py, PyAny>>, Option<[f64; 3]>, Option<&'a str>);

/// A function that makes the bodies of a cloud, to be called once there is a progress to note what it finds.
pub(crate) fn bodies_of(
    py: Python<'_>,
    (cloud, colours, viewpoint, kind): CloudArgument<'_, '_>,
) -> Result<impl FnOnce(&dyn Progress) -> Vec<Arc<ElasticBody>> + Send> {
    let kind = kind.map(|word| {
        let known: StrDeserializer<'_, ValueError> = word.into_deserializer();
        ObjectKind::deserialize(known).map_err(|_| {
            let message =
                format!("`object_kind` is {word:?}; wanted one of {:?}", ObjectKind::WORDS);
            PyValueError::new_err(message)
        })
    });
    let kind = kind.transpose()?;
    let (name, cloud) = extrapolate::read(py, cloud, colours)?;
    Ok(move |progress: &dyn Progress| {
        let colours = cloud.colours().expect("read with colours");
        let name = name.display().to_string();
        bodies((cloud.points(), colours), (viewpoint.map(Point3::from), kind), &name, progress)
    })
}

/// Learns a field with an elastic body from a cloud, as `palpate map --cloud` does.
///
/// `cloud` is the path of a PLY or PCD file with colours, or points (N, 3) m, world frame, with
/// `colours` (N, 3) from 0 to 255; `viewpoint` is where the camera stood, (3,) m, searched if left out;
/// `object_kind` is "plant" (stems, branches, leaves) or "cushion" (anything else that gives way), found from the
/// cloud if left out.
/// If `logs` is None, the body has the typical stiffness of other plants. A cloud in which nothing
/// stands above its lowest point gives a field without a body.
#[pyfunction]
#[pyo3(signature = (
    logs, cloud, colours = None, robot = None, *, viewpoint = None, object_kind = None, settings = None,
    progress = None, **sections
))]
#[allow(clippy::too_many_arguments)] // they are keywords
pub(crate) fn map_elastic(
    py: Python<'_>,
    logs: Option<&Bound<'_, PyAny>>,
    cloud: &Bound<'_, PyAny>,
    colours: Option<&Bound<'_, PyAny>>,
    robot: Option<&Bound<'_, PyAny>>,
    viewpoint: Option<[f64; 3]>,
    object_kind: Option<&str>,
    settings: Option<&Bound<'_, PyAny>>,
    progress: Option<&Bound<'_, PyAny>>,
    sections: Option<&Bound<'_, PyDict>>,
) -> Result<Field> {
    let mut settings = settings::read(settings, sections)?;
    match settings.estimator.estimator {
        Some(EstimatorKind::Elastic) | None => {}
        Some(other) => {
            let message = format!("`estimator` is {:?}; map_elastic is for elastic", other.name());
            return Err(PyValueError::new_err(message).into());
        }
    }
    settings.estimator.estimator = Some(EstimatorKind::Elastic);
    settings.config()?;
    let robot = robot::given(py, robot, &settings.robot)?;
    let sources = logs.map(sources).transpose()?.unwrap_or_default();
    let make_bodies = bodies_of(py, (cloud, colours, viewpoint, object_kind))?;
    let saved = long(py, progress, |progress| -> Result<_, WorkError> {
        let bodies = make_bodies(progress);
        let touches = opened(sources, &settings.log)?;
        touches.gravity_of_logs(&mut settings.touch, progress)?;
        settings.log.check_for(&robot.arm.robot)?;
        let arm = Arc::clone(&robot.arm);
        let config = settings.config()?; // after what the logs say of gravity
        let mut mapper = Mapper::new(arm, config).map_err(SettingsError::value)?;
        let place = (mapper.config().lattice.clone(), mapper.config().contact.clone());
        let mut touches = touches.for_arm(&robot.arm, &settings.log, place)?;
        let mut samples = Vec::new();
        let record = Some(&mut samples);
        learn(&mut mapper, &mut touches, &mut |_, _, _| (), record, progress)?;
        learn_body(&mapper, &bodies, samples, progress)
    })?;
    Field::of(py, saved)
}
