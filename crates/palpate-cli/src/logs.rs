//! What every command does first that reads logs: open them, load their arm, and, if it needs all of
//! them at once, read them.

use std::path::PathBuf;
use std::sync::Arc;

use palpate::{Arm, Differentiation};
use palpate_work::settings::sections::RobotSettings;
pub(crate) use palpate_work::touches::IfUndecided;
use palpate_work::touches::{RecordedTouch, Touches};
use palpate_work::{arm_file, robot};

use crate::error::CliError;
use crate::output::Output;
use crate::settings::Settings;

/// Opens logs and loads their arm; how the torques count, as the logs tell, goes into the settings.
pub(crate) fn open(
    logs: &[PathBuf],
    settings: &mut Settings,
    if_undecided: IfUndecided,
    output: &Output,
) -> Result<(Touches, Arc<Arm>), CliError> {
    let (mut touches, arm) = open_as_logged(logs, settings, output)?;
    touches.external(&arm, settings, if_undecided, output)?;
    Ok((touches, arm))
}

/// The same, before anything is known of how the torques count.
pub(crate) fn open_as_logged(
    logs: &[PathBuf],
    settings: &mut Settings,
    output: &Output,
) -> Result<(Touches, Arc<Arm>), CliError> {
    let mut touches = Touches::open(logs, &settings.log.options())?;
    let arm = robot::load(&settings.robot, output)?;
    let arm = touches.arm_of_logs(arm, &mut settings.robot, output)?;
    touches.angle_unit(&arm, settings, output)?;
    Ok((touches, arm))
}

/// Opens more logs of an arm, whose torques count as the settings say already.
pub(crate) fn open_more(
    logs: &[PathBuf],
    settings: &Settings,
    arm: &Arc<Arm>,
) -> Result<Touches, CliError> {
    let mut touches = Touches::open(logs, &settings.log.options())?;
    match arm_file::of(&settings.robot, &arm.robot)? {
        Some(model) => {
            touches.identified(arm, model, Differentiation::Centred, &settings.touch)?;
        }
        None => touches.refuse_currents()?,
    }
    Ok(touches)
}

/// Reads all touches, or the first so many, for a command that learns from them.
pub(crate) fn read(
    touches: Touches,
    arm: &Arc<Arm>,
    settings: &Settings,
    most: Option<u32>,
    output: &Output,
) -> Result<Vec<RecordedTouch>, CliError> {
    let config = settings.config()?;
    let place = (config.lattice, config.contact);
    let mut touches = touches.for_arm(arm, &settings.log, place.clone())?;
    let recorded = touches.read(most)?;
    touches.tell_warnings(output);
    touches.check(arm, place, &config.touch).of(&recorded).look(output)?;
    Ok(recorded)
}

/// The flags that name the robot of the logs, for a command that is to follow.
pub(crate) fn robot_flags(settings: &RobotSettings) -> String {
    let mut words = Vec::new();
    if let Some(robot) = &settings.robot {
        words.extend(["--robot".to_owned(), robot.clone()]);
    }
    for folder in settings.package_path.iter().flatten() {
        words.extend(["--package-path".to_owned(), folder.display().to_string()]);
    }
    for renamed in settings.rename.iter().flatten().cloned() {
        words.extend(["--rename".to_owned(), String::from(renamed)]);
    }
    if let Some(arm) = &settings.arm {
        words.extend(["--arm".to_owned(), arm.display().to_string()]);
    }
    let quoted =
        |word: String| if word.contains(' ') { format!(" '{word}'") } else { format!(" {word}") };
    words.into_iter().map(quoted).collect()
}

/// Tells which robot is used.
pub(crate) fn tell_robot(arm: &Arm, settings: &Settings, output: &Output) {
    output.note(&format!("robot {}, {} joints", settings.robot.name(), arm.robot.n_joints()));
}
