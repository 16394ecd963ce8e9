//! The touches that a field remembers, tracked again.

use std::path::Path;
use std::sync::Arc;

use palpate::unstable::LoggedTouch;
use palpate::{Arm, MapperConfig, Snapshot};
use palpate_io::field::SavedField;
use palpate_learn::tracked::{TouchSamples, TrackedTouches};

use crate::error::WorkError;
use crate::progress::Progress;

/// Whether a field remembers touches.
pub fn remembers(saved: &SavedField) -> bool {
    saved
        .snapshot
        .as_ref()
        .is_some_and(|snapshot| snapshot.sample_log.iter().any(|touch| !touch.open))
}

/// The touches in a field's sample log, tracked, and the settings under which they were learnt.
///
/// # Errors
///
/// If the field was learnt with another robot, or a sample cannot be used.
pub(super) fn recalled(
    snapshot: &Snapshot,
    path: &Path,
    arm: &Arc<Arm>,
    progress: &dyn Progress,
) -> Result<(TrackedTouches, MapperConfig), WorkError> {
    let name = path.display();
    let (learnt, fingerprint) = &snapshot.robot;
    if *fingerprint != arm.fingerprint() {
        return Err(WorkError::from(format!(
            "`{name}` was learnt with robot `{learnt}`, from which `{}` differs in joints, masses or \
             shapes; give the robot of the field (--robot, --payload-link, --payload-mass-kg)",
            arm.robot.name()
        )));
    }
    let touches: Vec<TouchSamples> = snapshot
        .sample_log
        .iter()
        .filter(|touch| !touch.open)
        .map(|touch| of(touch, snapshot.n_joints))
        .collect();
    let left_out = (snapshot.touches as usize).saturating_sub(touches.len());
    if left_out > 0 {
        let learnt = snapshot.touches;
        progress.warn(&format!(
            "{left_out} of the {learnt} touches from which `{name}` was learnt are not used: the field no longer \
             remembers them, or they were not ended"
        ));
    }
    progress.note(&format!("simulating the contacts of {} remembered touches", touches.len()));
    let tracked = TrackedTouches::new(arm, &snapshot.config, &touches, &|| progress.stopped());
    let tracked = tracked.map_err(|error| WorkError::from(format!("`{name}`: {error}")))?;
    Ok((tracked, snapshot.config.clone()))
}

fn of(logged: &LoggedTouch, n_joints: usize) -> TouchSamples {
    TouchSamples {
        name: format!("touch {}", logged.touch),
        samples: logged.samples(n_joints).collect(),
        truth: None,
    }
}
