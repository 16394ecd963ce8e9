//! Converts JSON to plain Python data, and plain Python data to TOML.

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyFloat, PyInt, PyMapping, PySequence, PyString};
use serde::de::DeserializeOwned;
use serde::de::value::{Error as ValueError, StrDeserializer};
use serde_json::Value;

use crate::lattice::Lattice;

/// Converts JSON to dicts, lists, numbers and strings.
pub(crate) fn python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    py.import(intern!(py, "json"))?.call_method1(intern!(py, "loads"), (value.to_string(),))
}

/// Converts dicts, lists, numbers and strings to a Rust type, through JSON.
pub(crate) fn of_python<T: DeserializeOwned>(plain: &Bound<'_, PyAny>) -> PyResult<T> {
    let json = plain.py().import("json")?.call_method1("dumps", (plain,))?;
    let value = serde_json::from_str(&json.extract::<String>()?);
    value.map_err(|error| PyValueError::new_err(error.to_string()))
}

/// The value that serde gives this name; `wanted` says in the error which names there are.
pub(crate) fn named<T: DeserializeOwned>(argument: &str, name: &str, wanted: &str) -> PyResult<T> {
    T::deserialize(StrDeserializer::<ValueError>::new(name))
        .map_err(|_| PyValueError::new_err(format!("`{argument}` is {name:?}; wanted {wanted}")))
}

/// Settings, or one section of them, without null values and empty sections.
pub(crate) fn given(settings: Value) -> Value {
    match settings {
        Value::Object(entries) => {
            let given = entries.into_iter().map(|(key, value)| (key, given(value)));
            let is_given = |value: &Value| {
                !value.is_null() && value.as_object().is_none_or(|keys| !keys.is_empty())
            };
            given.filter(|(_, value)| is_given(value)).collect()
        }
        other => other,
    }
}

/// Largest depth of nested lists and dicts; a deeper one may contain itself.
pub(crate) const DEEPEST: usize = 32;

/// Fails if `depth` exceeds [`DEEPEST`].
pub(crate) fn check_depth(depth: usize, name: &str) -> PyResult<()> {
    if depth <= DEEPEST {
        return Ok(());
    }
    let end: String = name.chars().take(40).collect();
    Err(PyValueError::new_err(format!(
        "`{end}` is nested more than {DEEPEST} times; does it hold itself?"
    )))
}

/// Converts plain data to TOML: `None` to nothing, a [`Lattice`] to its section; `name` is for
/// errors.
fn toml_of(any: &Bound<'_, PyAny>, name: &str, depth: usize) -> PyResult<Option<toml::Value>> {
    check_depth(depth, name)?;
    if any.is_none() {
        return Ok(None);
    }
    let value: toml::Value = if let Ok(truth) = any.cast::<PyBool>() {
        truth.is_true().into()
    } else if any.is_instance_of::<PyInt>() {
        any.extract::<i64>()?.into()
    } else if any.is_instance_of::<PyFloat>() {
        any.extract::<f64>()?.into()
    } else if any.is_instance_of::<PyString>() {
        any.extract::<String>()?.into()
    } else if let Ok(mapping) = any.cast::<PyMapping>() {
        nested_table_of(mapping, name, depth)?.into()
    } else if let Ok(lattice) = any.cast::<Lattice>() {
        toml::Value::try_from(&lattice.get().inner).expect("its keys are those of the section")
    } else if any.hasattr("tolist")? {
        // Arrays and scalars of NumPy.
        return toml_of(&any.call_method0("tolist")?, name, depth + 1);
    } else if any.hasattr("__fspath__")? {
        return toml_of(&any.call_method0("__fspath__")?, name, depth + 1);
    } else if let Ok(sequence) = any.cast::<PySequence>() {
        let mut values = Vec::new();
        for item in sequence.try_iter()? {
            values.extend(toml_of(&item?, name, depth + 1)?);
        }
        values.into()
    } else {
        return Err(PyTypeError::new_err(format!(
            "`{name}` holds {}; wanted numbers, strings, booleans, or lists and dicts of them",
            any.get_type().name()?
        )));
    };
    Ok(Some(value))
}

/// Converts a dict to a TOML table.
pub(crate) fn table_of(mapping: &Bound<'_, PyMapping>, name: &str) -> PyResult<toml::Table> {
    nested_table_of(mapping, name, 0)
}

fn nested_table_of(
    mapping: &Bound<'_, PyMapping>,
    name: &str,
    depth: usize,
) -> PyResult<toml::Table> {
    let mut table = toml::Table::new();
    for entry in mapping.items()? {
        let (key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>) = entry.extract()?;
        let Ok(key) = key.extract::<String>() else {
            return Err(PyTypeError::new_err(format!(
                "`{name}` has the key {key}; wanted strings as keys"
            )));
        };
        if let Some(value) = toml_of(&value, &format!("{name}.{key}"), depth + 1)? {
            table.insert(key, value);
        }
    }
    Ok(table)
}
