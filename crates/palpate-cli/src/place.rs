//! Places for results, tried before the work starts.

use std::path::Path;

use palpate_io::atomic::{self, IfExists};

use crate::error::CliError;

/// Refuses a place that cannot be written to; an older file there will be replaced.
pub(crate) fn check(path: &Path) -> Result<(), CliError> {
    atomic::check(path, IfExists::Replace).map_err(CliError::file)
}

/// Writes a text, whole or not at all.
pub(crate) fn write(path: &Path, text: &str) -> Result<(), CliError> {
    use std::io::Write;
    atomic::write(path, IfExists::Replace, |out| out.write_all(text.as_bytes()))
        .map_err(CliError::file)
}
