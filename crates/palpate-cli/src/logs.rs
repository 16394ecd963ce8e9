//! What every command does first that reads logs: open them and load their arm.

use std::path::PathBuf;
use std::sync::Arc;

use palpate::{Arm, Differentiation};
use palpate_work::settings::sections::{RobotSettings, TouchSettings};
pub(crate) use palpate_work::touches::IfUndecided;
use palpate_work::touches::Touches;
use palpate_work::{arm_file, inspect, robot};

use crate::error::CliError;
use crate::output::Output;
use crate::settings::Settings;

/// Opens logs and loads their arm; sign and gravity of the torques, as found in the logs, go into the settings.
pub(crate) fn open(
    logs: &[PathBuf],
    settings: &mut Settings,
    if_undecided: IfUndecided,
    output: &Output,
) -> Result<(Touches, Arc<Arm>), CliError> {
    let (mut touches, arm) = open_undecided(logs, settings, output)?;
    touches.prepare_torques(&arm, settings, if_undecided, output)?;
    Ok((touches, arm))
}

/// Opens logs and loads their arm, without deciding sign and gravity of the torques.
pub(crate) fn open_undecided(
    logs: &[PathBuf],
    settings: &mut Settings,
    output: &Output,
) -> Result<(Touches, Arc<Arm>), CliError> {
    let mut touches = Touches::open(logs, &settings.log.options())?;
    if settings.robot.robot.is_none() {
        output.note(&format!("no --robot: the built-in `{}` is used", settings.robot.name()));
    }
    let arm = robot::load(&settings.robot, output)?;
    let arm = touches.arm_of_logs(arm, &mut settings.robot, output)?;
    touches.angle_unit(&arm, settings, output)?;
    Ok((touches, arm))
}

/// Opens more logs of the same arm, with the sign and gravity of the torques that the settings already contain.
pub(crate) fn open_more(
    logs: &[PathBuf],
    settings: &Settings,
    arm: &Arc<Arm>,
) -> Result<Touches, CliError> {
    let mut touches = Touches::open(logs, &settings.log.options())?;
    match arm_file::of(&settings.robot, &arm.robot)? {
        Some(model) => {
            touches.read_measured()?;
            touches.use_arm_model(arm, model, Differentiation::Centred, &settings.touch)?;
        }
        None => touches.refuse_currents()?,
    }
    Ok(touches)
}

/// The flags that describe the robot, for the next command to run.
pub(crate) fn robot_flags(settings: &RobotSettings) -> String {
    let numbers =
        |numbers: &[f64]| numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    let mut flags: Vec<(&str, String)> = Vec::new();
    flags.extend(settings.robot.clone().map(|robot| ("robot", robot)));
    let folders = settings.package_path.iter().flatten();
    flags.extend(folders.map(|folder| ("package-path", folder.display().to_string())));
    flags.extend(settings.bake_spacing_m.map(|spacing| ("bake-spacing-m", numbers(&[spacing]))));
    flags.extend(settings.hold.iter().flatten().map(|held| ("hold", held.clone().into())));
    flags.extend(settings.rename.iter().flatten().map(|named| ("rename", named.clone().into())));
    flags.extend(settings.arm.as_ref().map(|arm| ("arm", arm.display().to_string())));
    flags.extend(settings.payload_link.clone().map(|link| ("payload-link", link)));
    flags.extend(settings.payload_mass_kg.map(|mass| ("payload-mass-kg", numbers(&[mass]))));
    flags.extend(settings.payload_com_m.map(|com| ("payload-com-m", numbers(&com))));
    let word = |(flag, value): &(&str, String)| {
        let parted = if value.starts_with('-') { '=' } else { ' ' };
        format!(" --{flag}{parted}{}", quoted(value))
    };
    flags.iter().map(word).collect()
}

/// The flags for sign and gravity of the torques, with a space before each.
pub(crate) fn torque_flags(settings: &TouchSettings) -> String {
    let sign =
        settings.torque_sign_given().map(|sign| format!(" --torque-sign {}", inspect::word(sign)));
    let gravity =
        settings.gravity_given().map(|gravity| format!(" --gravity {}", inspect::word(gravity)));
    sign.into_iter().chain(gravity).collect()
}

/// A word quoted for a shell, if necessary.
pub(crate) fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "_./=:,-+@".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

/// Notes which robot is used.
pub(crate) fn note_robot(arm: &Arm, settings: &Settings, output: &Output) {
    output.note(&format!("robot {}, {} joints", settings.robot.name(), arm.robot.n_joints()));
}
