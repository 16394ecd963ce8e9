//! Plain Python data from JSON, and TOML from plain Python data.

use pyo3::exceptions::PyTypeError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyMapping, PySequence, PyString};
use serde_json::Value;

/// JSON as dicts, lists, numbers and strings.
pub(crate) fn python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    Ok(match value {
        Value::Null => py.None().into_bound(py),
        Value::Bool(value) => PyBool::new(py, *value).to_owned().into_any(),
        Value::Number(number) => match (number.as_u64(), number.as_i64()) {
            (Some(whole), _) => whole.into_pyobject(py)?.into_any(),
            (_, Some(whole)) => whole.into_pyobject(py)?.into_any(),
            _ => PyFloat::new(py, number.as_f64().unwrap_or(f64::NAN)).into_any(),
        },
        Value::String(text) => PyString::new(py, text).into_any(),
        Value::Array(values) => {
            let list = PyList::empty(py);
            for value in values {
                list.append(python(py, value)?)?;
            }
            list.into_any()
        }
        Value::Object(entries) => {
            let dict = PyDict::new(py);
            for (key, value) in entries {
                dict.set_item(key, python(py, value)?)?;
            }
            dict.into_any()
        }
    })
}

/// The keys of a section that were given, as keywords.
pub(crate) fn given<'py>(py: Python<'py>, section: &Value) -> PyResult<Bound<'py, PyDict>> {
    let given = PyDict::new(py);
    for (key, value) in section.as_object().into_iter().flatten() {
        if !value.is_null() {
            given.set_item(key, python(py, value)?)?;
        }
    }
    Ok(given)
}

/// Plain data as TOML, `None` as nothing; `name` is for errors.
pub(crate) fn toml_of(any: &Bound<'_, PyAny>, name: &str) -> PyResult<Option<toml::Value>> {
    let py = any.py();
    if any.is_none() {
        return Ok(None);
    }
    if let Ok(truth) = any.cast::<PyBool>() {
        return Ok(Some(truth.is_true().into()));
    }
    if any.is_instance_of::<PyInt>() {
        return Ok(Some(any.extract::<i64>()?.into()));
    }
    if any.is_instance_of::<PyFloat>() {
        return Ok(Some(any.extract::<f64>()?.into()));
    }
    if any.is_instance_of::<PyString>() {
        return Ok(Some(any.extract::<String>()?.into()));
    }
    if let Ok(mapping) = any.cast::<PyMapping>() {
        return Ok(Some(table_of(mapping, name)?.into()));
    }
    // Arrays and single numbers of NumPy.
    if any.hasattr(intern!(py, "tolist"))? {
        return toml_of(&any.call_method0(intern!(py, "tolist"))?, name);
    }
    if any.hasattr(intern!(py, "__fspath__"))? {
        return toml_of(&any.call_method0(intern!(py, "__fspath__"))?, name);
    }
    if let Ok(sequence) = any.cast::<PySequence>() {
        let mut values = Vec::new();
        for item in sequence.try_iter()? {
            values.extend(toml_of(&item?, name)?);
        }
        return Ok(Some(values.into()));
    }
    Err(PyTypeError::new_err(format!(
        "`{name}` holds {}; wanted numbers, strings, booleans, or lists and dicts of them",
        any.get_type().name()?
    )))
}

/// A dict as a TOML table.
pub(crate) fn table_of(mapping: &Bound<'_, PyMapping>, name: &str) -> PyResult<toml::Table> {
    let mut table = toml::Table::new();
    for entry in mapping.items()? {
        let (key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>) = entry.extract()?;
        let Ok(key) = key.extract::<String>() else {
            return Err(PyTypeError::new_err(format!("`{name}` has the key {key}; wanted names")));
        };
        if let Some(value) = toml_of(&value, &format!("{name}.{key}"))? {
            table.insert(key, value);
        }
    }
    Ok(table)
}
