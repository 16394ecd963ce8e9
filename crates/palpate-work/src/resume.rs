//! A mapper that goes on from a saved field.

use std::path::Path;
use std::sync::Arc;

use palpate::{Arm, Mapper, Snapshot};
use palpate_io::field::{self, Saved};

use crate::error::WorkError;
use crate::settings::{Settings, first_difference};

/// What a field says of the mapper that learnt it; settings that were given must agree with it.
///
/// # Errors
///
/// If the file is no field, or as [`snapshot_of`].
pub fn snapshot(path: &Path, settings: &Settings) -> Result<Snapshot, WorkError> {
    let saved = field::load(path).map_err(WorkError::file)?;
    snapshot_of(saved, &path.display().to_string(), settings)
}

/// The same of a field that was read, and that errors call by this name.
///
/// # Errors
///
/// If it has no memory, or the settings contradict it.
pub fn snapshot_of(saved: Saved, name: &str, settings: &Settings) -> Result<Snapshot, WorkError> {
    let Some(snapshot) = saved.snapshot else {
        return Err(WorkError::from(format!(
            "`{name}` cannot be continued: it was saved without its memory; map its logs again \
             without --no-memory"
        )));
    };
    let given = settings.config_over_saved(&snapshot.config)?;
    if let Some(difference) = first_difference(&snapshot.config, &given) {
        return Err(WorkError::Usage(format!(
            "the settings contradict the field `{name}`, in which {difference}; leave them out \
             to go on with the field's own, or start a new field"
        )));
    }
    Ok(snapshot)
}

/// The mapper of a field that was saved in `path`.
///
/// # Errors
///
/// If it was learnt with another robot, or contradicts itself.
pub fn mapper(path: &Path, arm: &Arc<Arm>, snapshot: Snapshot) -> Result<Mapper, WorkError> {
    mapper_of(&path.display().to_string(), arm, snapshot)
}

/// The same of a field that errors call by this name.
///
/// # Errors
///
/// As [`mapper`].
pub fn mapper_of(name: &str, arm: &Arc<Arm>, snapshot: Snapshot) -> Result<Mapper, WorkError> {
    Mapper::resume(Arc::clone(arm), snapshot)
        .map_err(|error| WorkError::from(format!("`{name}` cannot be continued: {error}")))
}
