//! `palpate live` in a program built without it: says how to get it.

use std::ffi::OsString;

use crate::error::CliError;
use crate::output::Output;

/// Flags of `palpate live`, which are ignored.
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)] // `--help` also says how to get it
pub(crate) struct Args {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    _flags: Vec<OsString>,
}

/// Says how to get `palpate live`.
pub(crate) fn run(_: &Args, _: &Output) -> Result<(), CliError> {
    Err(CliError::Usage(palpate_io::not_built("`live`")))
}
