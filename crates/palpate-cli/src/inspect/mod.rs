//! `palpate inspect`: what a log, a robot or a field holds, and what looks wrong with it.

use std::path::PathBuf;

use crate::error::CliError;
use crate::output::Output;
use crate::settings::RobotAndLogSettings;

/// Flags of `palpate inspect`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Logs, URDFs, names of built-in robots, or fields
    #[arg(required = true, value_name = "PATH")]
    pub paths: Vec<PathBuf>,
    /// Print the findings as JSON
    #[arg(long)]
    pub json: bool,
    #[command(flatten)]
    pub settings: RobotAndLogSettings,
}

/// Inspects every path in turn.
pub(crate) fn run(args: &Args, _output: &Output) -> Result<(), CliError> {
    let _settings = args.settings.load()?;
    Err(CliError::Usage(format!("inspecting `{}` is not built yet", args.paths[0].display())))
}
