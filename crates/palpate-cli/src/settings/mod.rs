//! What the user sets: flags over a TOML file over the shipped defaults.
//!
//! One tree of structs ([`sections`]) is the flags, the file's keys and the template that
//! `palpate settings` prints, so the three cannot drift apart. The defaults are the core's own:
//! [`resolve`] lays the given values over them.

pub(crate) mod file;
mod layer;
mod parse;
mod resolve;
pub(crate) mod sections;
pub(crate) mod template;

use std::path::{Path, PathBuf};

use clap::Args;
use palpate::mapper::MapperError;
use palpate::robot::RobotError;
use serde::{Deserialize, Serialize};

pub(crate) use file::Keys;
pub(crate) use parse::vector3;
pub(crate) use resolve::{corners, departures, first_difference, lattice_in_words, same_lattice};
use sections::{
    ContactSettings, EstimatorSettings, LatticeSettings, LogSettings, RobotSettings, TouchSettings,
};

/// All that can be set; what was not given is `None`.
#[derive(Debug, Clone, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Settings {
    #[command(flatten)]
    pub robot: RobotSettings,
    #[command(flatten)]
    pub log: LogSettings,
    #[command(flatten)]
    pub touch: TouchSettings,
    #[command(flatten)]
    pub lattice: LatticeSettings,
    #[command(flatten)]
    pub contact: ContactSettings,
    #[command(flatten)]
    pub estimator: EstimatorSettings,
}

/// The settings of a command that learns: all of them.
#[derive(Debug, Clone, Args)]
pub(crate) struct AllSettings {
    #[command(flatten)]
    file: SettingsFile,
    #[command(flatten)]
    flags: Settings,
}

/// The settings of a command that asks a field, which brings lattice, contact model and
/// estimator with it.
#[derive(Debug, Clone, Args)]
pub(crate) struct RobotAndLogSettings {
    #[command(flatten)]
    file: SettingsFile,
    #[command(flatten)]
    robot: RobotSettings,
    #[command(flatten)]
    log: LogSettings,
    #[command(flatten)]
    touch: TouchSettings,
}

/// The settings of a command that only reads a log.
#[derive(Debug, Clone, Args)]
pub(crate) struct ReadSettings {
    #[command(flatten)]
    file: SettingsFile,
    #[command(flatten)]
    robot: RobotSettings,
    #[command(flatten)]
    log: LogSettings,
}

/// The settings of a command that asks a field which remembers its touches: the robot alone.
#[derive(Debug, Clone, Args)]
pub(crate) struct RobotOnlySettings {
    #[command(flatten)]
    file: SettingsFile,
    #[command(flatten)]
    robot: RobotSettings,
}

#[derive(Debug, Clone, Args)]
struct SettingsFile {
    /// TOML file with settings; flags win over it (`palpate settings` prints a template)
    #[arg(long = "settings", value_name = "FILE.toml")]
    path: Option<PathBuf>,
}

impl AllSettings {
    /// The settings file, if one was given.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.file.path.as_deref()
    }

    /// The flags over the file's values.
    pub(crate) fn load(&self) -> Result<Settings, SettingsError> {
        self.file.under(self.flags.clone())
    }
}

impl AllSettings {
    #[cfg(feature = "viewer")]
    /// The first kind of settings among the flags that only learning has, in a word.
    pub(crate) fn of_learning(&self) -> Option<&'static str> {
        let Settings { lattice, contact, estimator, .. } = &self.flags;
        if *lattice != LatticeSettings::default() {
            Some("lattice")
        } else if *contact != ContactSettings::default() {
            Some("contact")
        } else {
            (*estimator != EstimatorSettings::default()).then_some("estimator")
        }
    }
}

impl RobotAndLogSettings {
    /// The settings file, if one was given.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.file.path.as_deref()
    }

    /// The flags over the file's values.
    pub(crate) fn load(&self) -> Result<Settings, SettingsError> {
        let (robot, log, touch) = (self.robot.clone(), self.log.clone(), self.touch);
        self.file.under(Settings { robot, log, touch, ..Settings::default() })
    }
}

impl ReadSettings {
    /// The settings file, if one was given.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.file.path.as_deref()
    }

    /// The flags over the file's values.
    pub(crate) fn load(&self) -> Result<Settings, SettingsError> {
        let (robot, log) = (self.robot.clone(), self.log.clone());
        self.file.under(Settings { robot, log, ..Settings::default() })
    }
}

impl RobotOnlySettings {
    /// The settings file, if one was given.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.file.path.as_deref()
    }

    /// The flags over the file's values.
    pub(crate) fn load(&self) -> Result<Settings, SettingsError> {
        self.file.under(Settings { robot: self.robot.clone(), ..Settings::default() })
    }
}

impl SettingsFile {
    fn under(&self, flags: Settings) -> Result<Settings, SettingsError> {
        let settings = match &self.path {
            Some(path) => flags.over(file::read(path)?),
            None => flags,
        };
        settings.check()?;
        Ok(settings)
    }
}

/// What can be wrong with settings.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub(crate) enum SettingsError {
    /// The file cannot be read.
    #[error("the settings file `{}` cannot be read: {source}", path.display())]
    Unreadable { path: PathBuf, source: std::io::Error },
    /// Not TOML, or a value of the wrong kind.
    #[error("the settings file `{}` has an error\n{message}", path.display())]
    Toml { path: PathBuf, message: String },
    /// A key that means nothing.
    #[error("`{}`, line {line}: there is no setting `{key}`{remedy}", path.display())]
    UnknownKey { path: PathBuf, line: usize, key: String, remedy: String },
    /// A value outside its range.
    #[error("bad setting: {0}")]
    Value(Box<MapperError>),
    /// A value that would only cost hours or ruin the surface.
    #[error("bad setting: {key} is {found}; it must be at most {limit}: {reason}")]
    TooLarge { key: &'static str, found: f64, limit: f64, reason: &'static str },
    /// A box that is none.
    #[error("bad lattice: {0}")]
    Lattice(#[from] palpate::lattice::LatticeError),
    /// A payload that is none.
    #[error("bad payload: {0}")]
    Payload(#[from] RobotError),
    /// Settings that need or exclude each other.
    #[error("{0}")]
    Together(String),
}
