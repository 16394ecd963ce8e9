//! `--prior`: prior means of a new mapper from a field.
//!
//! The prior mean of a cell is `K_prior`, its expected stiffness before any touch, not the stiffness that the field has
//! learnt since: to keep that, continue with `--from`. An extrapolated `K_prior` comes from the touches themselves, so
//! learning the same touches with it uses them twice, and the error is a little larger than without. For a field
//! without the array `K_prior`, it is the learnt stiffness.

use std::path::Path;
use std::sync::Arc;

use palpate::{Arm, CellId, Lattice, Mapper, MapperConfig, MapperError};
use palpate_io::field::{self, SavedError, SavedField};

use crate::error::WorkError;
use crate::progress::Progress;
use crate::settings::{SettingsError, departures, lattice_in_words, same_lattice};

/// A new mapper, with prior means from the field in a file, if one is given.
///
/// # Errors
///
/// If the file is no field of palpate's, or as [`mapper_from`].
pub fn mapper(
    path: Option<&Path>,
    arm: &Arc<Arm>,
    config: MapperConfig,
    progress: &dyn Progress,
) -> Result<Mapper, WorkError> {
    let saved = path.map(load).transpose()?;
    let name = path.map(|path| path.display().to_string()).unwrap_or_default();
    let prior = saved.as_ref().map(|saved| (saved, name.as_str()));
    mapper_from(prior, arm, config, progress)
}

/// A new mapper, with prior means from a field, if one is given; `prior` is the field and its name in errors.
///
/// # Errors
///
/// If a setting is out of its range, or the field has another lattice.
pub fn mapper_from(
    prior: Option<(&SavedField, &str)>,
    arm: &Arc<Arm>,
    config: MapperConfig,
    progress: &dyn Progress,
) -> Result<Mapper, WorkError> {
    let means = match prior {
        Some((saved, name)) => expected(saved, name, &config, progress)?,
        None => Vec::new(),
    };
    let mapper = Mapper::with_prior(Arc::clone(arm), config, &means);
    mapper.map_err(|error| match (prior, error) {
        (Some((_, name)), error @ MapperError::PriorMeans(_)) => {
            WorkError::from(format!("`{name}` cannot be a prior: {error}"))
        }
        (_, error) => SettingsError::value(error).into(),
    })
}

/// The field in a file.
fn load(path: &Path) -> Result<SavedField, WorkError> {
    let name = path.display();
    field::load(path).map_err(|error| match error {
        SavedError::Foreign { missing, .. } => WorkError::from(format!(
            "`{name}` cannot be a prior: it is not a field of palpate, since the array `{missing}` is missing, which \
             says to which cells of the lattice its points belong; give a field that `palpate extrapolate --field` or \
             `palpate map` wrote"
        )),
        other => WorkError::file(other),
    })
}

/// Prior means from a field, N/m, for a mapper under these settings.
///
/// Notes the array that they come from, and warns if the field was learnt with another contact model.
fn expected(
    saved: &SavedField,
    name: &str,
    config: &MapperConfig,
    progress: &dyn Progress,
) -> Result<Vec<(CellId, f64)>, WorkError> {
    let SavedField { field, prior_n_per_m, .. } = saved;
    if !same_lattice(&field.lattice, &config.lattice) {
        return Err(WorkError::Usage(format!(
            "the prior `{name}` has a lattice of {}, the settings have {}, but both must have the same cells; \
             give {}, or make the prior again in the lattice of these settings",
            lattice_in_words(&field.lattice),
            lattice_in_words(&config.lattice),
            flags(&field.lattice)
        )));
    }
    let others = departures(&field.contact, &config.contact);
    if !others.is_empty() {
        progress.warn(&format!(
            "the prior `{name}` was learnt with another contact model, in which {}; with the \
             present one, the same object has another stiffness",
            others.join(" and ")
        ));
    }
    let array = if prior_n_per_m.is_some() { "K_prior" } else { "K" };
    progress
        .note(&format!("the prior means of {} cells are `{array}` of `{name}`", field.cells.len()));
    if field.elastic.is_some() {
        progress.note(&format!("the elastic body of `{name}` is not part of the prior"));
    }
    let means = prior_n_per_m.as_ref().unwrap_or(&field.stiffness_n_per_m);
    Ok(field.cells.iter().copied().zip(means.iter().copied()).collect())
}

/// The flags that give a lattice.
fn flags(lattice: &Lattice) -> String {
    let origin_m: [f64; 3] = lattice.origin_m().into();
    let [x, y, z] = origin_m;
    let [nx, ny, nz] = lattice.shape();
    format!("--spacing-m {} --origin-m={x},{y},{z} --shape {nx},{ny},{nz}", lattice.spacing_m())
}
