//! Extrapolation of stiffness from touched cells to points of a cloud.

use std::path::{Path, PathBuf};

use nalgebra::Point3;
use numpy::{PyArray1, PyArray2};
use palpate_io::cloud::{self, Cloud};
use palpate_learn::extrapolate::Features;
use palpate_work::extrapolate::{ExtrapolationJob, ExtrapolationSettings, filled, method_of};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyAny;

use crate::array::{Numbers, flat, numbers, points, table, whole};
use crate::error::{Raised, Result, SettingsError};
use crate::field::Field;
use crate::watch::long;

/// Stiffness estimated at each of N points of a cloud.
#[pyclass(frozen, module = "palpate", get_all)]
pub(crate) struct Extrapolation {
    /// Points of the cloud, (N, 3), m.
    points: Py<PyArray2<f64>>,
    /// K of a cell at each point, (N,), N/m.
    stiffness: Py<PyArray1<f64>>,
    /// Standard deviation of K: of the regression over features, not of single points, (N,), N/m.
    std: Py<PyArray1<f64>>,
    /// Whether the cell that contains the point was touched, (N,).
    touched: Py<PyArray1<bool>>,
    /// The field, with the estimates as prior of the untouched cells at points of the cloud.
    field: Py<Field>,
    /// `torque`, `cells` or `knn`.
    method: &'static str,
    /// Features by which points were compared.
    features: String,
}

#[pymethods]
impl Extrapolation {
    fn __repr__(&self) -> String {
        format!("Extrapolation({} on {})", self.method, self.features)
    }
}

/// Estimates the stiffness of untouched cells that a camera saw, as `palpate extrapolate` does.
///
/// `cloud` is the path of a PLY or PCD file with colours, or points (N, 3) m with `colours` (N, 3)
/// from 0 to 255. `method` is torque (if the field has its memory), cells or knn. If it is left out, it is
/// the one of torque and cells that predicts random halves of the remembered touches better; if both
/// predict worse than no extrapolation, `field` is returned unchanged, with a warning. `features` are a
/// colour (chroma, rgb, oklab), height and shape, joined by `+`.
#[pyfunction]
#[pyo3(signature = (
    field, cloud, colours = None, robot = None, *, method = None, features = None,
    reach_cells = None, length_scale = None, progress = None
))]
#[allow(clippy::too_many_arguments)] // they are keywords
pub(crate) fn extrapolate(
    py: Python<'_>,
    field: &Bound<'_, Field>,
    cloud: &Bound<'_, PyAny>,
    colours: Option<&Bound<'_, PyAny>>,
    robot: Option<&Bound<'_, PyAny>>,
    method: Option<&str>,
    features: Option<&str>,
    reach_cells: Option<f64>,
    length_scale: Option<f64>,
    progress: Option<&Bound<'_, PyAny>>,
) -> Result<Extrapolation> {
    let field = field.get();
    let robot = field.robot(py, robot)?;
    let (name, cloud) = read(py, cloud, colours)?;
    let wrong = |name: &str, why: &str| PyValueError::new_err(format!("`{name}`: {why}"));
    let method = method.map(method_of).transpose().map_err(|why| wrong("method", &why))?;
    let features = features.map(str::parse::<Features>).transpose();
    let features = features.map_err(|why| wrong("features", &why.to_string()))?;
    let given = ExtrapolationSettings { method, features, reach_cells, length_scale };
    let saved = field.saved(py, true);
    let found = long(py, progress, |progress| -> Result<_> {
        let work = ExtrapolationJob {
            arm: &robot.arm,
            saved: &saved,
            names: [Path::new("field"), name.as_path()],
            cloud: &cloud,
            given,
            halves: None,
            drawn: false,
            fills: true,
            kept: "nothing was kept",
        };
        Ok(work.run(progress)?)
    })?;
    let places: Vec<[f64; 3]> = cloud.points().iter().map(|&point| point.into()).collect();
    Ok(Extrapolation {
        points: table(py, places.into_flattened(), 3),
        stiffness: flat(py, found.extrapolation.stiffness_n_per_m),
        std: flat(py, found.extrapolation.std_n_per_m),
        touched: flat(py, found.extrapolation.touched),
        field: Py::new(py, Field::of(py, filled(saved, &found.cells))?)?,
        method: found.config.method.name(),
        features: found.config.features.to_string(),
    })
}

/// A cloud from a file, or from points and their colours; with its name for error messages.
pub(crate) fn read(
    py: Python<'_>,
    any: &Bound<'_, PyAny>,
    colours: Option<&Bound<'_, PyAny>>,
) -> Result<(PathBuf, Cloud)> {
    let wrong = |message: String| Raised::from(PyValueError::new_err(message));
    let Some(colours) = colours else {
        let path: PathBuf = any.extract().map_err(|_| {
            PyValueError::new_err(
                "`cloud` holds points, but their `colours`, which distinguish the parts of the object, are \
                 not given: wanted (N, 3) from 0 to 255, or the path of a PLY or PCD file with both",
            )
        })?;
        let cloud = py.detach(|| cloud::read(&path))?.cloud;
        if cloud.colours().is_none() {
            let message = format!(
                "`{}` has points but no colours, which distinguish the parts of the object; export it \
                 with red, green and blue",
                path.display()
            );
            return Err(SettingsError::new_err(message).into());
        }
        return Ok((path, cloud));
    };
    let places = points(any, "cloud")?;
    if let Some(row) = places.iter().position(|point| point.iter().any(|x| !x.is_finite())) {
        let message = format!("`cloud` holds a number that is not finite in row {row} (from 0)");
        return Err(wrong(message));
    }
    let Numbers { values, shape } = numbers(colours, "colours", "(N, 3), from 0 to 255")?;
    if shape != [places.len(), 3] {
        let wanted = format!("wanted ({}, 3), as `cloud`", places.len());
        return Err(wrong(format!("`colours` has shape {shape:?}; {wanted}")));
    }
    let bytes = whole(&values, 3, "colours", u8::MAX.into())?;
    let bytes: Vec<u8> = bytes.into_iter().map(|byte| byte as u8).collect();
    let places = places.into_iter().map(Point3::from).collect();
    Ok((PathBuf::from("cloud"), Cloud::new(places, Some(bytes.as_chunks::<3>().0.to_vec()))))
}
