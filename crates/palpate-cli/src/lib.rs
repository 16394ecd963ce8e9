//! The command `palpate`, as a function: the program of that name and the Python package call it.
//!
//! Each subcommand has a module, which parses no arguments and prints only through `output`;
//! `error` has the exit codes. A panic prints an apology and what to report, not a backtrace.

mod args;
mod bench;
mod bundled;
mod cloud_args;
mod compare;
mod convert;
mod demo;
mod error;
mod evaluate;
#[cfg(test)]
mod example;
mod excite;
mod extrapolate;
mod extrapolation_view;
mod file_paths;
mod forget;
mod hull;
mod identify;
mod inspect;
mod interrupt;
#[cfg(feature = "full")]
mod live;
#[cfg(not(feature = "full"))]
#[path = "live/not_built.rs"]
mod live;
mod logs;
mod map;
mod next;
mod object_args;
mod output;
mod pace;
mod picture;
mod predict;
mod program;
mod report;
mod settings;
mod study;
mod torque;
mod tune;
mod view;

use std::ffi::OsString;

use palpate_work::error::with_causes;

use args::{Cli, Command};
use error::{CliError, exit_code};
use output::{Output, complain};

pub use program::Program;

/// Runs the command with these arguments, the first of which is the command's own name, and returns its exit code.
///
/// It ends the process if the arguments ask for help or cannot be parsed, and sets the process's handlers of panics and
/// Ctrl-C: a process calls it once, and does nothing else.
pub fn command(arguments: impl IntoIterator<Item = OsString>, program: Program) -> u8 {
    program.begin();
    std::panic::set_hook(Box::new(apologise));
    let cli = Cli::of(arguments);
    let output = Output { quiet: cli.quiet };
    if let Some(gib) = cli.file_memory {
        palpate_io::input::set_largest((gib * f64::from(1 << 30)) as u64);
    }
    match run(&cli.command, &output) {
        Ok(()) => 0,
        Err(error) => {
            let code = exit_code(&error);
            if code != 0 {
                report(&error);
            }
            code
        }
    }
}

fn run(command: &Command, output: &Output) -> Result<(), CliError> {
    match command {
        Command::Map(args) => map::run(args, output),
        Command::Live(args) => live::run(args, output),
        #[cfg(feature = "full")]
        Command::LiveNetwork => palpate_live::ros::run_network().map_err(|error| {
            CliError::from(format!("this command can only be started by `palpate live`: {error}"))
        }),
        Command::Predict(args) => predict::run(args, output),
        Command::Compare(args) => compare::run(args, output),
        Command::Forget(args) => forget::run(args, output),
        Command::Next(args) => next::run(args, output),
        Command::Evaluate(args) => evaluate::run(args, output),
        Command::Tune(args) => tune::run(args, output),
        Command::Study(args) => study::run(args, output),
        Command::Extrapolate(args) => extrapolate::run(args, output),
        Command::Demo(args) => demo::run(args, output),
        Command::Excite(args) => excite::run(args, output),
        Command::Identify(args) => identify::run(args, output),
        Command::Torque(args) => torque::run(args, output),
        Command::Inspect(args) => inspect::run(args, output),
        Command::View(args) => view::run(args, output),
        Command::Convert(args) => convert::run(args, output),
        Command::Bench(args) => bench::run(args, output),
        Command::Settings(args) => output.result(&args.load()?.template()?),
        Command::Completions { shell } => args::completions(*shell, output),
    }
}

/// Prints an error, and under it the causes that its message does not already name.
fn report(error: &CliError) {
    let lines = with_causes(error);
    complain(&format!("error: {}", lines[0]));
    for cause in &lines[1..] {
        complain(&format!("  because {cause}"));
    }
}

/// The panic hook: prints an apology and what to report, in place of a backtrace.
fn apologise(panic: &std::panic::PanicHookInfo<'_>) {
    let place = panic.location().map(ToString::to_string).unwrap_or_default();
    let what = panic.payload_as_str().unwrap_or("no reason given");
    complain(&format!(
        "error: palpate has a defect and had to stop, sorry: {what} ({place})\n\
         please report this line, the command you ran and the version ({}); no file was left \
         half written",
        env!("CARGO_PKG_VERSION")
    ));
}
