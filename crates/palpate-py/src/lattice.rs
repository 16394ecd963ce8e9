//! The lattice: the workspace box and its points.

use numpy::{PyArray1, PyArray2};
use palpate::CellId;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyAny;

use crate::array::{counts, flat, points, row, table};
use crate::error::Result;

/// Points at equal spacing in a box, in the frame of the robot's base.
///
/// `origin` is the first point (3,) m, `spacing` the distance between neighbours in m, `shape` the
/// number of points along x, y and z. The cell number of a point runs fastest along x.
#[pyclass(frozen, eq, module = "palpate")]
#[derive(Clone, PartialEq)]
pub(crate) struct Lattice {
    pub(crate) inner: palpate::Lattice,
}

/// An argument of three numbers.
fn three(any: &Bound<'_, PyAny>, name: &str) -> PyResult<[f64; 3]> {
    let row = row(any, name, Some(3))?;
    Ok([row[0], row[1], row[2]])
}

#[pymethods]
impl Lattice {
    #[new]
    fn new(origin: &Bound<'_, PyAny>, spacing: f64, shape: &Bound<'_, PyAny>) -> Result<Self> {
        let sides = counts(shape, "shape")?;
        let Ok(sides) = <[u32; 3]>::try_from(sides) else {
            return Err(
                PyValueError::new_err("`shape` must be three counts, along x, y and z").into()
            );
        };
        Ok(Self { inner: palpate::Lattice::new(three(origin, "origin")?, spacing, sides)? })
    }

    /// The lattice that fills the box from corner `low` to `high` (3,) m, every `spacing` m.
    #[staticmethod]
    fn filling(low: &Bound<'_, PyAny>, high: &Bound<'_, PyAny>, spacing: f64) -> Result<Self> {
        let (low, high) = (three(low, "low")?, three(high, "high")?);
        Ok(Self { inner: palpate::Lattice::filling(low, high, spacing)? })
    }

    /// First point, m.
    #[getter]
    fn origin(&self) -> [f64; 3] {
        self.inner.origin_m().into()
    }

    /// Distance between neighbouring points, m.
    #[getter]
    fn spacing(&self) -> f64 {
        self.inner.spacing_m()
    }

    /// Number of points along x, y and z.
    #[getter]
    fn shape(&self) -> (u32, u32, u32) {
        self.inner.shape().into()
    }

    /// Number of points.
    #[getter]
    fn n_cells(&self) -> u64 {
        self.inner.n_cells()
    }

    /// The cell nearest to each of `points` (M, 3) m: (M,), -1 outside the box.
    #[pyo3(signature = (points, /))]
    fn cells(&self, py: Python<'_>, points: &Bound<'_, PyAny>) -> PyResult<Py<PyArray1<i64>>> {
        let places = self::points(points, "points")?;
        let cell = |point: &[f64; 3]| {
            self.inner.nearest(&(*point).into()).map_or(-1, |cell| i64::from(cell.0))
        };
        Ok(flat(py, places.iter().map(cell).collect()))
    }

    /// The rest point of each of `cells` (M,): (M, 3) m.
    #[pyo3(signature = (cells, /))]
    fn points(&self, py: Python<'_>, cells: &Bound<'_, PyAny>) -> PyResult<Py<PyArray2<f64>>> {
        let cells = counts(cells, "cells")?;
        if let Some(cell) = cells.iter().find(|&&cell| !self.inner.contains(CellId(cell))) {
            let n = self.inner.n_cells();
            let message = format!("`cells` holds {cell}; the lattice has {n} cells, from 0 on");
            return Err(PyValueError::new_err(message));
        }
        let point = |cell: &u32| <[f64; 3]>::from(self.inner.point(CellId(*cell)));
        Ok(table(py, cells.iter().flat_map(point).collect(), 3))
    }

    fn __hash__(&self, py: Python<'_>) -> PyResult<isize> {
        let (origin, spacing, shape) = self.__getnewargs__();
        let (origin, shape) = (<(f64, f64, f64)>::from(origin), <(u32, u32, u32)>::from(shape));
        (origin, spacing, shape).into_pyobject(py)?.hash()
    }

    fn __repr__(&self) -> String {
        let (origin, spacing, shape) = self.__getnewargs__();
        format!("Lattice(origin={origin:?}, spacing={spacing:?}, shape={shape:?})")
    }

    fn __getnewargs__(&self) -> ([f64; 3], f64, [u32; 3]) {
        (self.inner.origin_m().into(), self.inner.spacing_m(), self.inner.shape())
    }
}
