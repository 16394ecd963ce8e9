//! Loads the robot that the settings name, with its payload.

use std::path::PathBuf;
use std::sync::Arc;

use palpate::{Arm, Snapshot};
use palpate_io::robot_files::{ArmOptions, CachePlace, LoadedArm, load_arm};

use crate::error::WorkError;
use crate::progress::Progress;
use crate::settings::sections::{RobotSettings, Section};
use crate::settings::{HeldJoint, RenamedJoint, SettingsError};

/// As [`load_with_report`], and warns of what looked odd in the robot's files.
pub fn load(settings: &RobotSettings, progress: &dyn Progress) -> Result<Arc<Arm>, WorkError> {
    let loaded = load_with_report(settings)?;
    loaded.warnings.iter().for_each(|warning| progress.warn(warning));
    Ok(Arc::new(loaded.arm))
}

/// Loads the robot with its payload, renamed joints and joints that stand still; returns warnings with it.
pub fn load_with_report(settings: &RobotSettings) -> Result<LoadedArm, WorkError> {
    let payload = settings.payload()?;
    let mut loaded = load_arm(settings.name(), &settings.options()).map_err(WorkError::file)?;
    if let Some(payload) = payload {
        loaded.arm.robot =
            loaded.arm.robot.with_payload(&payload).map_err(SettingsError::Payload)?;
    }
    let renamed = settings.rename.iter().flatten();
    let renamed: Vec<(&str, &str)> =
        renamed.map(|RenamedJoint { in_log, in_urdf }| (&**in_urdf, &**in_log)).collect();
    loaded.arm.robot = (loaded.arm.robot.with_renamed_joints(&renamed))
        .map_err(|error| WorkError::Usage(format!("--rename: {error}")))?;
    for HeldJoint { joint, position } in settings.hold.iter().flatten() {
        let held = loaded.arm.robot.with_fixed_joint(joint, *position);
        loaded.arm.robot =
            held.map_err(|error| WorkError::Usage(format!("--hold {joint}: {error}")))?;
    }
    Ok(loaded)
}

/// Warns if a field was learnt with another arm, which is allowed.
pub fn warn_of_other_robot(field: (&str, Option<&Snapshot>), arm: &Arm, progress: &dyn Progress) {
    if let Some(which) = other_robot(field, arm, "the one of this log") {
        progress.warn(&format!("the field was learnt with {which}; {OF_FIELD}"));
    }
}

/// The remedy for [`other_robot`].
pub(crate) const OF_FIELD: &str =
    "give the robot of the field with --robot, --payload-link and --bake-spacing-m";

/// In what the arm of a field, by name and snapshot, differs from `arm`, which is `given`; `None` if it is the same.
/// Arms are compared by fingerprint if the field has a snapshot, else by name.
pub(crate) fn other_robot(
    (name, snapshot): (&str, Option<&Snapshot>),
    arm: &Arm,
    given: &str,
) -> Option<String> {
    let own = arm.robot.name();
    let is_own = match snapshot {
        Some(snapshot) => snapshot.robot.1 == arm.fingerprint(),
        None => name == own,
    };
    (!is_own).then(|| match name == own {
        true => format!("`{name}` with other joints, masses or shapes than {given}"),
        false => format!("another robot (`{name}`) than {given} (`{own}`)"),
    })
}

impl RobotSettings {
    fn options(&self) -> ArmOptions {
        let cache = match (&self.cache_dir, self.no_cache) {
            (_, Some(true)) => CachePlace::Off,
            (Some(folder), _) => CachePlace::At(PathBuf::clone(folder)),
            (None, _) => CachePlace::User,
        };
        let mut options = ArmOptions { cache, ..ArmOptions::default() };
        self.set(&mut options);
        options
    }
}
