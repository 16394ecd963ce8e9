//! The file of an identified arm, `arm.toml`: what `palpate identify` writes and other commands read with `--arm`.
//!
//! Its keys are `version`, `robot`, `torque_sign` and `gravity` of the torques from which the arm was identified, and the
//! fields of [`TorqueModel`]; other results of the identification are comments.

use std::io::ErrorKind;
use std::path::Path;

use palpate::{ExternalTorqueConfig, Robot, TorqueModel};
use palpate_io::input;
use serde::Deserialize;

use crate::conventions::KnownConvention;
use crate::error::WorkError;
use crate::inspect::word;
use crate::progress::Progress;
use crate::settings::sections::RobotSettings;
use crate::settings::{OrAuto, Settings};

/// Largest size of the file, bytes.
const LARGEST: u64 = 1 << 20;

/// Version of the format.
const VERSION: i64 = 2;

/// The text of the file, with remarks as comments at the top; `torques` is the convention of the torques from which the
/// arm was identified.
pub fn text(
    robot: &Robot,
    model: &TorqueModel,
    torques: &ExternalTorqueConfig,
    remarks: &str,
) -> String {
    let remarks = remarks.lines().map(|line| format!("# {line}").trim_end().to_owned() + "\n");
    let remarks: String = remarks.collect();
    let mut head = toml::Table::new();
    head.insert("version".to_owned(), VERSION.into());
    head.insert("robot".to_owned(), robot.name().into());
    head.insert("torque_sign".to_owned(), word(torques.torque_sign).into());
    head.insert("gravity".to_owned(), word(torques.gravity).into());
    let model = toml::to_string(model).expect("a model has numbers and names");
    format!("{remarks}\n{head}\n{model}")
}

/// The model of the identified arm that the settings name, if they name one.
///
/// # Errors
///
/// If the file cannot be read, is not such a file, or belongs to another robot.
pub fn of(settings: &RobotSettings, robot: &Robot) -> Result<Option<TorqueModel>, WorkError> {
    Ok(settings.arm.as_deref().map(|path| read(path, robot)).transpose()?.map(|(model, _)| model))
}

/// The convention of the torques from which the arm was identified that the settings name; empty if they name none, or
/// the file does not say.
///
/// # Errors
///
/// As [`of`].
pub(crate) fn convention(
    settings: &RobotSettings,
    robot: &Robot,
) -> Result<KnownConvention, WorkError> {
    let found = settings.arm.as_deref().map(|path| read(path, robot)).transpose()?;
    Ok(found.map_or_else(KnownConvention::default, |(_, convention)| convention))
}

/// Takes sign and gravity of the torques from the file of the identified arm, where the settings leave them open: for a
/// running robot, whose torques cannot be read ahead.
///
/// # Errors
///
/// As [`of`].
pub fn complete_convention(settings: &mut Settings, robot: &Robot) -> Result<(), WorkError> {
    let found = convention(&settings.robot, robot)?;
    let touch = &mut settings.touch;
    if let Some(sign) = found.torque_sign.filter(|_| touch.torque_sign_given().is_none()) {
        touch.torque_sign = Some(OrAuto::Is(sign));
    }
    if let Some(gravity) = found.gravity.filter(|_| touch.gravity_given().is_none()) {
        touch.gravity = Some(OrAuto::Is(gravity));
    }
    Ok(())
}

/// The model of the identified arm that the settings name; if they name none, the model of the URDF, with a note.
///
/// # Errors
///
/// If the file cannot be read, is not such a file, or belongs to another robot.
pub fn or_urdf(
    settings: &RobotSettings,
    robot: &Robot,
    progress: &dyn Progress,
) -> Result<TorqueModel, WorkError> {
    if let Some(model) = of(settings, robot)? {
        if settings.payload_mass_kg.is_some() {
            progress.note(
                "--payload-mass-kg has no effect with --arm: the masses of that file are used",
            );
        }
        return Ok(model);
    }
    progress.note(
        "no --arm: friction and the sensors' bias stay in the torques, and their standard deviation is a guess; \
         `palpate identify` finds all of them from free motion",
    );
    Ok(TorqueModel::of_urdf(robot))
}

/// Reads the file, and checks that it belongs to this robot.
///
/// # Errors
///
/// If it cannot be read, is not such a file, or belongs to another robot.
fn read(path: &Path, robot: &Robot) -> Result<(TorqueModel, KnownConvention), WorkError> {
    let wrong = |what: &str| WorkError::Usage(format!("`{}`: {what}", path.display()));
    let text = input::read_text(path, LARGEST).map_err(|error| match error.kind() {
        ErrorKind::InvalidData => {
            wrong("this is no file of `palpate identify`: it is not a text file")
        }
        _ => wrong(&error.to_string()),
    })?;
    let broken = |error: toml::de::Error| {
        wrong(&format!("this is no file of `palpate identify`: {}", error.to_string().trim_end()))
    };
    let mut file: toml::Table = toml::from_str(&text).map_err(broken)?;
    match file.remove("version").and_then(|version| version.as_integer()) {
        Some(VERSION) => {}
        found => {
            let found = found.map_or("none".to_owned(), |version| version.to_string());
            let wanted = format!("wanted version {VERSION} of a file of `palpate identify`");
            return Err(wrong(&format!("{wanted}, found {found}: identify the arm again")));
        }
    }
    file.remove("robot");
    let [sign, gravity] = ["torque_sign", "gravity"].map(|key| file.remove(key));
    let convention = KnownConvention {
        torque_sign: sign.map(toml::Value::try_into).transpose().map_err(broken)?,
        gravity: gravity.map(toml::Value::try_into).transpose().map_err(broken)?,
    };
    let model = TorqueModel::deserialize(file).map_err(broken)?;
    model.check(robot).map_err(|what| wrong(&what))?;
    Ok((model, convention))
}
