//! Settings from a TOML file or a dict, overridden by sections given as keywords.

use std::path::PathBuf;

use palpate_work::settings::{self, Settings};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};
use serde_json::json;

use crate::data::{given, python, table_of};
use crate::error::Result;

/// The settings of a call: `settings`, a file or a dict, overridden by `sections` such as
/// `contact={"friction": 0.3}`.
pub(crate) fn read(
    settings: Option<&Bound<'_, PyAny>>,
    sections: Option<&Bound<'_, PyDict>>,
) -> Result<Settings> {
    let lower = match settings {
        None => Settings::default(),
        Some(any) => match any.cast::<PyMapping>() {
            Ok(mapping) => settings::of_table(&table_of(mapping, "settings")?)?,
            Err(_) => of_file(any)?,
        },
    };
    let upper = match sections {
        None => Settings::default(),
        Some(given) => settings::of_table(&table_of(given.as_mapping(), "settings")?)?,
    };
    Ok(upper.over(lower))
}

fn of_file(path: &Bound<'_, PyAny>) -> Result<Settings> {
    let path: PathBuf = path.extract().map_err(|_| {
        PyTypeError::new_err(format!(
            "`settings` is {path}; wanted the path of a TOML file, or a dict of its sections"
        ))
    })?;
    let settings = settings::read(&path)?;
    settings.check()?;
    Ok(settings)
}

/// The settings of one section, given as keywords.
pub(crate) fn section(name: &str, keys: Option<&Bound<'_, PyDict>>) -> Result<Settings> {
    let mut table = toml::Table::new();
    if let Some(keys) = keys {
        table.insert(name.to_owned(), table_of(keys.as_mapping(), name)?.into());
    }
    Ok(settings::of_table(&table)?)
}

/// The given settings, from a file or a dict, checked, as a dict of sections.
#[pyfunction]
#[pyo3(signature = (settings = None, **sections))]
pub(crate) fn given_settings<'py>(
    py: Python<'py>,
    settings: Option<&Bound<'py, PyAny>>,
    sections: Option<&Bound<'py, PyDict>>,
) -> Result<Bound<'py, PyAny>> {
    Ok(python(py, &given(json!(read(settings, sections)?)))?)
}

/// All settings, with defaults for those not given: a dict of sections with every key.
#[pyfunction]
#[pyo3(signature = (settings = None, **sections))]
pub(crate) fn default_settings<'py>(
    py: Python<'py>,
    settings: Option<&Bound<'py, PyAny>>,
    sections: Option<&Bound<'py, PyDict>>,
) -> Result<Bound<'py, PyAny>> {
    Ok(python(py, &json!(read(settings, sections)?.effective()?))?)
}
