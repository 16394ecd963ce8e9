//! A mapper that goes on from a saved field.

use std::path::Path;
use std::sync::Arc;

use palpate::arm::Arm;
use palpate::mapper::{Mapper, Snapshot};
use palpate_io::field;

use crate::error::CliError;
use crate::settings::{Settings, first_difference};

/// What a field says of the mapper that learnt it; settings that were given must agree with it.
pub(crate) fn snapshot(path: &Path, settings: &Settings) -> Result<Snapshot, CliError> {
    let name = path.display();
    let Some(snapshot) = field::load(path).map_err(CliError::file)?.snapshot else {
        return Err(CliError::from(format!(
            "`{name}` cannot be continued: it was saved without its memory; map its logs again \
             without --no-memory"
        )));
    };
    let given = settings.config_over_saved(&snapshot.config)?;
    if let Some(difference) = first_difference(&snapshot.config, &given) {
        return Err(CliError::Usage(format!(
            "the settings contradict the field `{name}`, in which {difference}; leave them out \
             to go on with the field's own, or start a new field"
        )));
    }
    Ok(snapshot)
}

/// The mapper of a field that was saved in `path`.
pub(crate) fn mapper(path: &Path, arm: &Arc<Arm>, snapshot: Snapshot) -> Result<Mapper, CliError> {
    let name = path.display();
    Mapper::resume(Arc::clone(arm), snapshot)
        .map_err(|error| CliError::from(format!("`{name}` cannot be continued: {error}")))
}
