//! The settings of each kind of command, from flags and a file.
//!
//! The settings themselves are defined in `palpate_work`.

use std::path::{Path, PathBuf};

use clap::Args;
use palpate::EstimatorKind;
use palpate_work::elastic::without_body;
use palpate_work::settings::sections::{
    ContactSettings, LatticeSettings, LogSettings, RobotSettings, TouchSettings,
};
pub(crate) use palpate_work::settings::*;

/// The settings of a command: flags, and a file for settings that no flag gives.
#[derive(Debug, Clone, Args)]
pub(crate) struct SettingsArgs<F: Args> {
    /// TOML file with settings; flags win over it (`palpate settings` prints a template)
    #[arg(long = "settings", value_name = "FILE.toml")]
    path: Option<PathBuf>,
    #[command(flatten)]
    flags: F,
}

impl<F: Args + Clone + Into<Settings>> SettingsArgs<F> {
    /// The settings file, if one was given.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    /// As `load`, for a command that starts a mapper without a body: refuses the estimator
    /// `elastic`.
    pub(crate) fn load_without_body(&self) -> Result<Settings, SettingsError> {
        let settings = self.load()?;
        match settings.estimator.estimator {
            Some(EstimatorKind::Elastic) => Err(without_body()),
            _ => Ok(settings),
        }
    }

    /// The settings of the flags, and those of the file that no flag gives.
    pub(crate) fn load(&self) -> Result<Settings, SettingsError> {
        let given = self.flags.clone().into();
        let settings = match &self.path {
            Some(path) => given.over(read(path)?),
            None => given,
        };
        settings.check()?;
        Ok(settings)
    }
}

/// The settings of a command that learns: all of them.
pub(crate) type AllSettings = SettingsArgs<Settings>;

/// The settings of a command that needs the robot only.
pub(crate) type RobotOnlySettings = SettingsArgs<RobotSettings>;

/// Flags of a command that only reads logs.
#[derive(Debug, Clone, Args)]
pub(crate) struct RobotAndLog {
    #[command(flatten)]
    robot: RobotSettings,
    #[command(flatten)]
    log: LogSettings,
}

/// The settings of a command that only reads logs.
pub(crate) type RobotAndLogSettings = SettingsArgs<RobotAndLog>;

impl From<RobotAndLog> for Settings {
    fn from(RobotAndLog { robot, log }: RobotAndLog) -> Self {
        Self { log, ..robot.into() }
    }
}

/// Flags of a command that takes lattice, contact model and estimator from a field, or needs none.
#[derive(Debug, Clone, Args)]
pub(crate) struct RobotLogAndTouch {
    #[command(flatten)]
    read: RobotAndLog,
    #[command(flatten)]
    touch: TouchSettings,
}

/// The settings of a command with the flags [`RobotLogAndTouch`].
pub(crate) type RobotLogAndTouchSettings = SettingsArgs<RobotLogAndTouch>;

impl From<RobotLogAndTouch> for Settings {
    fn from(RobotLogAndTouch { read, touch }: RobotLogAndTouch) -> Self {
        Self { touch, ..read.into() }
    }
}

/// Flags of a command that computes what a log touches, and learns nothing.
#[derive(Debug, Clone, Args)]
pub(crate) struct LogAndLattice {
    #[command(flatten)]
    log: RobotLogAndTouch,
    #[command(flatten)]
    lattice: LatticeSettings,
    #[command(flatten)]
    contact: ContactSettings,
}

/// The settings of a command with the flags [`LogAndLattice`].
pub(crate) type LogAndLatticeSettings = SettingsArgs<LogAndLattice>;

impl From<LogAndLattice> for Settings {
    fn from(LogAndLattice { log, lattice, contact }: LogAndLattice) -> Self {
        Self { lattice, contact, ..log.into() }
    }
}

#[cfg(feature = "viewer")]
impl AllSettings {
    /// The name of the first section among the given flags that is used by learning only.
    pub(crate) fn of_learning(&self) -> Option<&'static str> {
        let (given, none) = (&self.flags, Settings::default());
        [
            ("lattice", given.lattice != none.lattice),
            ("contact", given.contact != none.contact),
            ("estimator", given.estimator != none.estimator),
        ]
        .into_iter()
        .find_map(|(kind, given)| given.then_some(kind))
    }
}
