//! Starts a viewer with its usage statistics off.
//!
//! `rerun` has no flag for this, only a setting that `rerun analytics disable` writes into the
//! user's configuration folder. On Linux, `XDG_CONFIG_HOME` gives the viewer a separate folder, so
//! the user's own settings are not changed. On other systems the user's own setting is changed.

use std::ffi::OsStr;
use std::io::ErrorKind;
use std::path::Path;
use std::process::{Command, Stdio};

use re_sdk::{SpawnError, SpawnOptions};

/// Version of Rerun that can show these recordings.
pub const VERSION: &str = "0.36";
/// The command that starts a viewer.
const RERUN: &str = "rerun";
/// Environment variable for the configuration folder.
const SETTINGS: &str = "XDG_CONFIG_HOME";

/// Why no viewer was started.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum StartError {
    /// The command `rerun` is not installed.
    #[error("there is no command `rerun` (the viewer) in PATH")]
    Missing,
    /// Its usage statistics could not be switched off.
    #[error(
        "the usage statistics of the viewer could not be switched off, so it was not started: \
         `rerun analytics disable` {reason}"
    )]
    Statistics { reason: String },
    /// It could not be started.
    #[error("the viewer could not be started: {reason}")]
    Failed { reason: String },
}

/// Starts a viewer and returns its address, where it answers once it has started; it keeps running
/// after this program ends.
///
/// `settings`: configuration folder of the viewer; created if missing.
///
/// # Errors
///
/// If there is no viewer, if its usage statistics cannot be switched off, or if it does not start.
pub fn start(settings: &Path) -> Result<String, StartError> {
    switch_statistics_off(OsStr::new(RERUN), settings)?;
    let options = SpawnOptions {
        new: true,
        hide_welcome_screen: true,
        executable_path: Some(RERUN.to_owned()),
        extra_env: vec![(SETTINGS.to_owned(), settings.display().to_string())],
        ..SpawnOptions::default()
    };
    match re_sdk::spawn(&options) {
        Ok(started) => Ok(format!("rerun+http://127.0.0.1:{}/proxy", started.port)),
        Err(SpawnError::ExecutableNotFound { .. }) => Err(StartError::Missing),
        Err(error) => Err(StartError::Failed { reason: error.to_string() }),
    }
}

/// Writes the setting; fails with [`StartError::Missing`] if there is no viewer.
fn switch_statistics_off(rerun: &OsStr, settings: &Path) -> Result<(), StartError> {
    let refused = |reason: String| StartError::Statistics { reason };
    std::fs::create_dir_all(settings).map_err(|error| {
        refused(format!("needs the folder `{}`, which cannot be made: {error}", settings.display()))
    })?;
    let off = Command::new(rerun)
        .args(["analytics", "disable"])
        .env(SETTINGS, settings)
        .stdin(Stdio::null())
        .output();
    match off {
        Err(error) if error.kind() == ErrorKind::NotFound => Err(StartError::Missing),
        Err(error) => Err(refused(format!("cannot be run: {error}"))),
        Ok(output) if output.status.success() => Ok(()),
        Ok(output) => {
            let said = String::from_utf8_lossy(&output.stderr);
            Err(refused(format!("ended with {}: {}", output.status, said.trim())))
        }
    }
}
