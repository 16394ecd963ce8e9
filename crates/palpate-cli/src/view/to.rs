//! Where a recording goes: a viewer that is started, one that runs, or a file.

use std::io;
use std::path::PathBuf;

use palpate_io::atomic;
use palpate_io::robot_files::CachePlace;
use palpate_view::viewer::{self, StartError};
use palpate_view::{Recording, Scene, ViewError};

use crate::error::CliError;

use super::args::Args;

/// Where a recording goes.
pub(super) enum To {
    /// The viewer at this address.
    Viewer(String),
    /// A file, whole or not at all.
    File(PathBuf),
}

impl To {
    /// The requested destination; starts a viewer if none was requested.
    pub(super) fn of(args: &Args) -> Result<Self, CliError> {
        match (&args.save, &args.connect) {
            (Some(path), _) => Ok(Self::File(path.clone())),
            (None, Some(url)) => Ok(Self::Viewer(url.clone())),
            (None, None) => started().map(Self::Viewer),
        }
    }

    /// Makes a recording with the content that `say` writes; returns where it is, and the result of `say`.
    pub(super) fn record<T>(
        self,
        scene: &Scene,
        say: impl FnOnce(&mut Recording<'_>) -> Result<T, CliError>,
    ) -> Result<(String, T), CliError> {
        match self {
            Self::Viewer(url) => {
                let recording = Recording::to_viewer(&url, scene);
                Ok((url, all(recording.map_err(failed)?, say)?))
            }
            Self::File(path) => {
                let mut said = None;
                let written = atomic::write(&path, |out| {
                    let recording = Recording::to_file(out, scene).map_err(failed);
                    match recording.and_then(|recording| all(recording, say)) {
                        // A full disk: the error of `atomic` names the place and the remedy.
                        Err(CliError::Write { source, .. }) => Err(source),
                        result => {
                            let whole = result.is_ok();
                            said = Some(result);
                            if whole { Ok(()) } else { Err(io::ErrorKind::Other.into()) }
                        }
                    }
                });
                match (said, written) {
                    (Some(Err(error)), _) => Err(error),
                    (_, Err(error)) => Err(CliError::file(error)),
                    (Some(Ok(said)), Ok(())) => Ok((path.display().to_string(), said)),
                    (None, Ok(())) => unreachable!("a recording without a result was not written"),
                }
            }
        }
    }
}

/// Starts a viewer and returns its address.
pub(crate) fn started() -> Result<String, CliError> {
    let cache = CachePlace::User.folder().unwrap_or_else(std::env::temp_dir);
    viewer::start(&cache.join("viewer")).map_err(|error| could_not_start(&error))
}

/// Writes all content with `say` and ends the recording.
fn all<'out, T>(
    mut recording: Recording<'out>,
    say: impl FnOnce(&mut Recording<'_>) -> Result<T, CliError>,
) -> Result<T, CliError> {
    let said = say(&mut recording)?;
    recording.finish().map_err(failed)?;
    Ok(said)
}

/// The error of the command if something could not be shown.
pub(crate) fn failed(error: ViewError) -> CliError {
    match error {
        ViewError::Write(source) => CliError::Write { what: "the recording".to_owned(), source },
        ViewError::Address { .. } => CliError::Usage(error.to_string()),
        ViewError::NoAnswer { .. } => CliError::from(format!(
            "{error}; start one with the command `rerun`, or write a file with --save FILE.rrd"
        )),
        other => CliError::file(other),
    }
}

fn could_not_start(error: &StartError) -> CliError {
    let version = viewer::VERSION;
    CliError::from(format!(
        "{error}; install it with `pip install 'rerun-sdk=={version}.*'` or `cargo install --locked \
         rerun-cli@{version}.0`, or write a file with --save FILE.rrd, or show it in a viewer that \
         runs with --connect"
    ))
}
