//! `--prior`: the stiffness that a field expects of its cells, for a mapper that starts anew.
//!
//! The prior of a cell is `K_prior`, what was expected of it before any touch, and not what the field
//! has learnt since: whoever wants to keep that goes on with `--from`. An extrapolated `K_prior` comes
//! from the touches themselves, so that to learn them again from it uses them twice, for a little
//! more error than without. A field without that array expects what it has learnt.

use std::path::Path;
use std::sync::Arc;

use palpate::arm::Arm;
use palpate::lattice::{CellId, Lattice};
use palpate::mapper::{Config, Mapper, MapperError};
use palpate_io::field::{self, Saved, SavedError};

use crate::error::CliError;
use crate::output::Output;
use crate::settings::{SettingsError, departures, lattice_in_words, same_lattice};

/// A mapper that knows nothing yet but what the field in a file expects, if one is given.
pub(crate) fn mapper(
    path: Option<&Path>,
    arm: &Arc<Arm>,
    config: Config,
    output: &Output,
) -> Result<Mapper, CliError> {
    let prior = match path {
        Some(path) => read(path, &config, output)?,
        None => Vec::new(),
    };
    let mapper = Mapper::with_prior(Arc::clone(arm), config, &prior);
    mapper.map_err(|error| match (path, error) {
        (Some(path), error @ MapperError::Expected(_)) => {
            CliError::from(format!("`{}` cannot be a prior: {error}", path.display()))
        }
        (_, error) => SettingsError::Value(Box::new(error)).into(),
    })
}

/// What the field in a file expects of its cells, N/m, for a mapper under these settings.
///
/// Tells where the numbers come from, and if they were learnt with another contact model.
fn read(path: &Path, config: &Config, output: &Output) -> Result<Vec<(CellId, f64)>, CliError> {
    let name = path.display();
    let Saved { field, prior_n_per_m, .. } = field::load(path).map_err(|error| match error {
        SavedError::Foreign { missing, .. } => CliError::from(format!(
            "`{name}` cannot be a prior: it is no field of palpate's, since it lacks the array \
             `{missing}`, and so does not say which cells of which lattice its points are; give \
             the field that `palpate extrapolate --field` or `palpate map` wrote"
        )),
        other => CliError::file(other),
    })?;
    if !same_lattice(&field.lattice, &config.lattice) {
        return Err(CliError::Usage(format!(
            "the prior `{name}` has a lattice of {}, the settings have {}, and a cell of one is \
             none of the other; give {}, or make the prior anew in the lattice of these settings",
            lattice_in_words(&field.lattice),
            lattice_in_words(&config.lattice),
            flags(&field.lattice)
        )));
    }
    let others = departures(&field.contact, &config.contact);
    if !others.is_empty() {
        output.note(&format!(
            "the prior `{name}` was learnt with another contact model, in which {}; under this one \
             the same object has another stiffness",
            others.join(" and ")
        ));
    }
    let array = if prior_n_per_m.is_some() { "K_prior" } else { "K" };
    output.note(&format!("the prior of {} cells is `{array}` of `{name}`", field.cells.len()));
    let means = prior_n_per_m.unwrap_or(field.stiffness_n_per_m);
    Ok(field.cells.into_iter().zip(means).collect())
}

/// The flags that give a lattice.
fn flags(lattice: &Lattice) -> String {
    let origin_m: [f64; 3] = lattice.origin_m().into();
    let [x, y, z] = origin_m;
    let [nx, ny, nz] = lattice.shape();
    format!("--spacing-m {} --origin-m={x},{y},{z} --shape {nx},{ny},{nz}", lattice.spacing_m())
}
