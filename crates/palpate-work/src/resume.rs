//! A mapper that continues from a saved field.

use std::fmt::Display;
use std::path::Path;
use std::sync::Arc;

use palpate::{Arm, ExternalTorqueConfig, Field, Mapper, MapperConfig, MapperError, Snapshot};
use palpate_io::field::{self, SavedField};

use crate::error::WorkError;
use crate::progress::Progress;
use crate::settings::{Settings, first_difference};

/// The snapshot in a saved field, which given settings must not contradict. `name` is the name of the field in errors.
///
/// # Errors
///
/// If the field was saved without its memory, has an elastic body or was learnt with another robot, or the settings
/// contradict it.
pub fn snapshot_of(
    saved: SavedField,
    name: &str,
    arm: &Arm,
    settings: &Settings,
) -> Result<Snapshot, WorkError> {
    if saved.field.elastic.is_some() {
        return Err(WorkError::from(format!(
            "`{name}` holds an elastic body; only `palpate map --from` and `palpate live --resume` can \
             continue from it"
        )));
    }
    let Some(snapshot) = saved.snapshot else {
        return Err(WorkError::from(format!(
            "`{name}` cannot be continued: it was saved without its memory; map its logs again \
             without --no-memory"
        )));
    };
    snapshot.check_arm(arm).map_err(|error| not_continued(name, &error))?;
    let is_identified = settings.robot.arm.is_some();
    if snapshot.config.touch.identified != is_identified {
        let (was, how) = if is_identified {
            ("without an identified arm", "leave out --arm")
        } else {
            ("from the external torques of an identified arm", "give its file (--arm)")
        };
        return Err(WorkError::Usage(format!(
            "the field `{name}` was learnt {was}: {how} to go on with it, or start a new field"
        )));
    }
    check_settings(&snapshot.config, name, settings)?;
    Ok(snapshot)
}

/// The configuration under which a field was learnt, which given settings must not contradict. If it was learnt with an
/// identified arm, the convention of measured torques is that of the settings alone.
///
/// # Errors
///
/// If the file is no field, or the settings contradict it.
pub(crate) fn config(path: &Path, settings: &Settings) -> Result<MapperConfig, WorkError> {
    let saved = field::load(path).map_err(WorkError::file)?;
    let mut config = match saved.snapshot {
        Some(snapshot) => snapshot.config,
        None => {
            let mut config = MapperConfig::of(settings.estimator.estimator.unwrap_or_default());
            let Field { lattice, contact, touch, .. } = saved.field;
            (config.lattice, config.contact, config.touch) = (lattice, contact, touch);
            config
        }
    };
    if config.touch.identified {
        config.touch = settings.touch.over_config(&ExternalTorqueConfig::default());
    }
    check_settings(&config, &path.display().to_string(), settings)?;
    Ok(config)
}

/// Refuses given settings that differ from those of a saved field.
fn check_settings(saved: &MapperConfig, name: &str, given: &Settings) -> Result<(), WorkError> {
    match first_difference(saved, &given.config_over_saved(saved)?) {
        None => Ok(()),
        Some(difference) => Err(WorkError::Usage(format!(
            "the settings contradict the field `{name}`, in which {difference}; leave them out \
             to go on with the field's own, or start a new field"
        ))),
    }
}

/// Restores the mapper from the snapshot of a field; `name` is the name of the field in errors.
///
/// # Errors
///
/// If the field was learnt with another robot, if its snapshot is inconsistent, or on being stopped.
pub fn mapper(
    name: impl Display,
    arm: &Arc<Arm>,
    snapshot: Snapshot,
    progress: &dyn Progress,
) -> Result<Mapper, WorkError> {
    let n_joints = arm.robot.n_joints();
    let samples: usize = snapshot.sample_log.iter().map(|touch| touch.q.len() / n_joints).sum();
    let bar = progress.begin(Some(samples as u64), "samples", "simulating remembered touches");
    let step = || {
        bar.step();
        !progress.stopped()
    };
    match Mapper::resume_unless_stopped(Arc::clone(arm), snapshot, step) {
        Ok(Some(mapper)) => Ok(mapper),
        Ok(None) => Err(WorkError::Interrupted { kept: format!("; `{name}` is unchanged") }),
        Err(error) => Err(not_continued(name, &error)),
    }
}

fn not_continued(name: impl Display, error: &MapperError) -> WorkError {
    WorkError::from(format!("`{name}` cannot be continued: {error}"))
}
