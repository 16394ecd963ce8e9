//! The file of an identified arm, `arm.toml`: what `palpate identify` writes and other commands read with `--arm`.
//!
//! Its values are those of [`TorqueModel`], by the names of its fields; what else was found out is in remarks.

use std::path::Path;

use palpate::{Robot, TorqueModel};
use palpate_io::input;
use serde::{Deserialize, Serialize};

use crate::error::WorkError;

/// Bytes of the largest file.
const LARGEST: u64 = 1 << 20;

/// What is in the file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ArmFile {
    /// Version of this format.
    version: u32,
    /// Name of the robot, as its URDF says.
    robot: String,
    #[serde(flatten)]
    model: toml::Table,
}

/// Version of the format.
const VERSION: u32 = 1;

/// The text of the file, with remarks on top.
pub fn text(robot: &Robot, model: &TorqueModel, remarks: &str) -> String {
    let remarks = remarks.lines().map(|line| format!("# {line}").trim_end().to_owned() + "\n");
    let remarks: String = remarks.collect();
    let model = toml::Table::try_from(model).expect("a model has numbers and names");
    let file = ArmFile { version: VERSION, robot: robot.name().to_owned(), model };
    let body = toml::to_string(&file).expect("a model has numbers and names");
    format!("{remarks}\n{body}")
}

/// Reads the file, and checks that it is one of this robot.
///
/// # Errors
///
/// If it cannot be read, is not such a file, or is of another robot.
pub fn read(path: &Path, robot: &Robot) -> Result<TorqueModel, WorkError> {
    let wrong = |what: &str| WorkError::Usage(format!("`{}`: {what}", path.display()));
    let text = input::read_text(path, LARGEST).map_err(|error| wrong(&error.to_string()))?;
    let broken = |error: toml::de::Error| {
        wrong(&format!("this is no file of `palpate identify`: {}", error.to_string().trim_end()))
    };
    let file: ArmFile = toml::from_str(&text).map_err(broken)?;
    if file.version != VERSION {
        let version = file.version;
        return Err(wrong(&format!("it has version {version}; this palpate reads {VERSION}")));
    }
    let model = TorqueModel::deserialize(file.model).map_err(broken)?;
    model.check(robot).map_err(|what| wrong(&what))?;
    Ok(model)
}
