//! Conversion between NumPy arrays and rows of numbers.
//!
//! Input: anything that NumPy converts to an array of floats or integers, contiguous or not,
//! read-only or not. Output: read-only arrays that own the memory of the Rust vectors, without a copy.

use numpy::ndarray::Array2;
use numpy::{
    Element, IntoPyArray, PyArray1, PyArray2, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;

/// Numbers and their shape.
pub(crate) struct Numbers {
    /// In C order.
    pub(crate) values: Vec<f64>,
    /// Length of each dimension.
    pub(crate) shape: Vec<usize>,
}

/// The numbers of the argument `name`; `wanted` is the expected shape, for error messages.
pub(crate) fn numbers(any: &Bound<'_, PyAny>, name: &str, wanted: &str) -> PyResult<Numbers> {
    let py = any.py();
    let numpy = py.import(intern!(py, "numpy"))?;
    let array = numpy.call_method1(intern!(py, "asarray"), (any,)).map_err(|error| {
        let found = any.get_type().name().map_or("something".to_owned(), |name| name.to_string());
        let message = format!(
            "`{name}` must be an array of numbers, {wanted}; found {found}, which NumPy cannot convert: {error}"
        );
        if error.is_instance_of::<PyTypeError>(py) {
            PyTypeError::new_err(message)
        } else {
            PyValueError::new_err(message)
        }
    })?;
    let dtype = array.getattr(intern!(py, "dtype"))?;
    let kind: String = dtype.getattr(intern!(py, "kind"))?.extract()?;
    if !["f", "i", "u"].contains(&kind.as_str()) {
        return Err(PyTypeError::new_err(format!(
            "`{name}` has dtype {dtype}; wanted float64, or floats and integers that become it, \
             {wanted}"
        )));
    }
    let array = numpy.call_method1(intern!(py, "asarray"), (&array, "float64", "C"))?;
    let array = array.cast_into::<PyArrayDyn<f64>>().map_err(PyErr::from)?;
    let values = array.try_readonly().map_err(|error| PyValueError::new_err(error.to_string()))?;
    let values = values.as_slice().map_err(PyErr::from)?.to_vec();
    Ok(Numbers { values, shape: array.shape().to_vec() })
}

/// A one-dimensional argument, of the given length if there is one.
pub(crate) fn row(any: &Bound<'_, PyAny>, name: &str, length: Option<usize>) -> PyResult<Vec<f64>> {
    let wanted = match length {
        Some(length) => format!("({length},)"),
        None => "(N,)".to_owned(),
    };
    let Numbers { values, shape } = numbers(any, name, &wanted)?;
    match shape[..] {
        [n] if length.is_none_or(|length| n == length) => Ok(values),
        _ => Err(wrong_shape(name, &shape, &wanted)),
    }
}

/// A two-dimensional argument as rows, with this number of columns if given; `wanted` is the expected shape.
pub(crate) fn rows(
    any: &Bound<'_, PyAny>,
    name: &str,
    columns: Option<usize>,
    wanted: &str,
) -> PyResult<Vec<Vec<f64>>> {
    let Numbers { values, shape } = numbers(any, name, wanted)?;
    match shape[..] {
        [_, n] if n > 0 && columns.is_none_or(|columns| n == columns) => {
            Ok(values.chunks(n).map(<[f64]>::to_vec).collect())
        }
        _ => Err(wrong_shape(name, &shape, wanted)),
    }
}

/// Points, (N, 3).
pub(crate) fn points(any: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<[f64; 3]>> {
    let wanted = "(N, 3)";
    let Numbers { values, shape } = numbers(any, name, wanted)?;
    match shape[..] {
        [_, 3] => Ok(values.as_chunks::<3>().0.to_vec()),
        _ => Err(wrong_shape(name, &shape, wanted)),
    }
}

/// One point or several, (3,) or (N, 3).
pub(crate) fn places(any: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<[f64; 3]>> {
    let wanted = "(3,) or (N, 3)";
    let Numbers { values, shape } = numbers(any, name, wanted)?;
    match shape[..] {
        [3] | [_, 3] => Ok(values.as_chunks::<3>().0.to_vec()),
        _ => Err(wrong_shape(name, &shape, wanted)),
    }
}

/// Counts: whole numbers from 0 to the largest `u32`.
pub(crate) fn counts(any: &Bound<'_, PyAny>, name: &str) -> PyResult<Vec<u32>> {
    whole(&row(any, name, None)?, 1, name, u32::MAX)
}

/// Converts whole numbers from 0 to `most`; `columns` is the length of a row, for error messages.
pub(crate) fn whole(numbers: &[f64], columns: usize, name: &str, most: u32) -> PyResult<Vec<u32>> {
    for (place, number) in numbers.iter().enumerate() {
        if number.fract() != 0.0 || !(0.0..=f64::from(most)).contains(number) {
            let row = place / columns;
            return Err(PyValueError::new_err(format!(
                "`{name}` holds {number} in row {row} (from 0); wanted whole numbers from 0 to {most}"
            )));
        }
    }
    Ok(numbers.iter().map(|&number| number as u32).collect())
}

/// The error for an array of the wrong shape.
fn wrong_shape(name: &str, shape: &[usize], wanted: &str) -> PyErr {
    let sides: Vec<String> = shape.iter().map(ToString::to_string).collect();
    let found = match &sides[..] {
        [side] => format!("({side},)"),
        sides => format!("({})", sides.join(", ")),
    };
    PyValueError::new_err(format!("`{name}` has shape {found}; wanted {wanted}"))
}

/// A read-only array that owns these values.
pub(crate) fn flat<T: Element>(py: Python<'_>, values: Vec<T>) -> Py<PyArray1<T>> {
    let array = values.into_pyarray(py);
    array.readwrite().make_nonwriteable();
    array.unbind()
}

/// A read-only two-dimensional array that owns these values, with this number of columns.
pub(crate) fn table<T: Element>(py: Python<'_>, values: Vec<T>, columns: usize) -> Py<PyArray2<T>> {
    let rows = values.len().checked_div(columns).unwrap_or(0);
    let table = Array2::from_shape_vec((rows, columns), values).expect("rows are of one length");
    let array = table.into_pyarray(py);
    array.readwrite().make_nonwriteable();
    array.unbind()
}

/// A read-only two-dimensional array with a copy of these rows.
pub(crate) fn table_of<'a>(
    py: Python<'_>,
    rows: impl IntoIterator<Item = &'a [f64]>,
    columns: usize,
) -> Py<PyArray2<f64>> {
    table(py, rows.into_iter().flatten().copied().collect(), columns)
}

/// A copy of the values of an array made by [`flat`].
pub(crate) fn copied<T: Element + Copy>(py: Python<'_>, array: &Py<PyArray1<T>>) -> Vec<T> {
    array.bind(py).readonly().as_slice().expect("made contiguous").to_vec()
}
