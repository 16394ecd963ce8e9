//! The settings of each kind of command, as flags over a file.
//!
//! What can be set, and what it means, is `palpate_work`'s.

use std::path::{Path, PathBuf};

use clap::Args;
use palpate_work::settings::sections::{
    ContactSettings, LatticeSettings, LogSettings, RobotSettings, TouchSettings,
};
pub(crate) use palpate_work::settings::*;

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

/// The settings of a command that looks at what a log touches, and learns nothing.
#[derive(Debug, Clone, Args)]
pub(crate) struct LogAndLatticeSettings {
    #[command(flatten)]
    log: RobotAndLogSettings,
    #[command(flatten)]
    lattice: LatticeSettings,
    #[command(flatten)]
    contact: ContactSettings,
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

    /// The first kind of settings among the flags that only learning has, in a word.
    #[cfg(feature = "viewer")]
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

impl LogAndLatticeSettings {
    /// The flags over the file's values.
    pub(crate) fn load(&self) -> Result<Settings, SettingsError> {
        let (lattice, contact) = (self.lattice, self.contact);
        let RobotAndLogSettings { file, robot, log, touch } = self.log.clone();
        let flags = Settings { robot, log, touch, lattice, contact, ..Settings::default() };
        file.under(flags)
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
            Some(path) => flags.over(read(path)?),
            None => flags,
        };
        settings.check()?;
        Ok(settings)
    }
}
