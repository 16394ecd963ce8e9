//! Settings from a TOML file or a dict, with sections given apart laid over them.

use std::path::PathBuf;

use palpate::EstimatorKind;
use palpate_work::settings::{self, Settings};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};

use crate::data::{python, table_of, toml_of};
use crate::error::of_bad_settings;
use crate::lattice::Lattice;

/// What a call says of settings.
#[derive(Default)]
pub(crate) struct SettingsGiven<'a, 'py> {
    /// A file or a dict.
    pub(crate) settings: Option<&'a Bound<'py, PyAny>>,
    /// Sections by name, such as `contact={"friction": 0.3}`.
    pub(crate) sections: Option<&'a Bound<'py, PyDict>>,
    /// The estimator.
    pub(crate) method: Option<&'a str>,
}

impl SettingsGiven<'_, '_> {
    /// The settings, with what is given apart over what the file or the dict says.
    pub(crate) fn read(&self) -> PyResult<Settings> {
        let lower = match self.settings {
            None => Settings::default(),
            Some(any) => match any.cast::<PyMapping>() {
                Ok(mapping) => of_table(&sections(mapping)?)?,
                Err(_) => {
                    let path: PathBuf = any.extract().map_err(|_| {
                        PyTypeError::new_err(format!(
                            "`settings` is {any}; wanted the path of a TOML file, or a dict of its \
                             sections"
                        ))
                    })?;
                    let settings = settings::read(&path).map_err(of_bad_settings)?;
                    settings.check().map_err(of_bad_settings)?;
                    settings
                }
            },
        };
        let mut upper = match self.sections {
            None => Settings::default(),
            Some(given) => of_table(&sections(given.as_mapping())?)?,
        };
        if let Some(method) = self.method {
            let kind = EstimatorKind::named(method).ok_or_else(|| {
                let message = format!("`method` is {method:?}; wanted \"map\" or \"ekf\"");
                PyValueError::new_err(message)
            })?;
            upper.estimator.estimator = Some(kind);
        }
        Ok(upper.over(lower))
    }
}

/// Settings of a table.
fn of_table(table: &toml::Table) -> PyResult<Settings> {
    settings::of_table(table).map_err(of_bad_settings)
}

/// Sections as TOML; a [`Lattice`] stands for its own.
fn sections(mapping: &Bound<'_, PyMapping>) -> PyResult<toml::Table> {
    let plain = PyDict::new(mapping.py());
    let mut lattice = None;
    for entry in mapping.items()? {
        let (key, value): (Bound<'_, PyAny>, Bound<'_, PyAny>) = entry.extract()?;
        match value.cast::<Lattice>() {
            Ok(found) => lattice = Some((key.extract::<String>()?, found.get().section())),
            Err(_) => plain.set_item(key, value)?,
        }
    }
    let mut table = table_of(plain.as_mapping(), "settings")?;
    table.extend(lattice.map(|(key, section)| (key, section.into())));
    Ok(table)
}

/// A section of keywords, for a class that has one.
pub(crate) fn section(name: &str, keys: &Bound<'_, PyDict>) -> PyResult<Settings> {
    let mut table = toml::Table::new();
    if let Some(section) = toml_of(keys.as_any(), name)? {
        table.insert(name.to_owned(), section);
    }
    of_table(&table)
}

/// The settings that are given, as a dict of sections: a file's, or those of a dict after a check.
#[pyfunction]
#[pyo3(signature = (settings = None, **sections))]
pub(crate) fn given_settings<'py>(
    py: Python<'py>,
    settings: Option<&Bound<'py, PyAny>>,
    sections: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let settings = SettingsGiven { settings, sections, method: None }.read()?;
    let plain = serde_json::to_value(&settings).expect("settings are plain data");
    python(py, &without_nulls(&plain))
}

/// Sections with the keys that were given.
pub(crate) fn without_nulls(value: &serde_json::Value) -> serde_json::Value {
    match value {
        serde_json::Value::Object(entries) => entries
            .iter()
            .filter(|(_, value)| !value.is_null())
            .map(|(key, value)| (key.clone(), without_nulls(value)))
            .filter(|(_, value)| value.as_object().is_none_or(|section| !section.is_empty()))
            .collect(),
        other => other.clone(),
    }
}

/// All settings that hold when no more than this is said: a dict of sections with every key.
#[pyfunction]
#[pyo3(signature = (settings = None, **sections))]
pub(crate) fn default_settings<'py>(
    py: Python<'py>,
    settings: Option<&Bound<'py, PyAny>>,
    sections: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let settings = SettingsGiven { settings, sections, method: None }.read()?;
    let all = settings.effective().map_err(of_bad_settings)?;
    python(py, &serde_json::to_value(all).expect("settings are plain data"))
}
