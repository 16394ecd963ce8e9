//! The command line: subcommands, and the flags that all of them share.

use std::ffi::OsString;
use std::ops::RangeInclusive;

use clap::{Arg, CommandFactory, FromArgMatches, Parser, Subcommand};
use clap_complete::Shell;
use palpate_work::tune::Tune;

use crate::error::CliError;
use crate::output::Output;
use crate::settings::AllSettings;
use crate::{
    bench, compare, convert, demo, evaluate, excite, extrapolate, forget, identify, inspect, live,
    map, next, predict, study, torque, tune, view,
};

/// Learns where an object is stiff from the joint torques of a robot arm that touches it.
#[derive(Debug, Parser)]
#[command(name = "palpate", version, max_term_width = 100)]
pub(crate) struct Cli {
    /// No progress and no notes on stderr; results, warnings and errors only
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Largest memory that the content of one file may take at once, GiB [default: 1]
    #[arg(
        long, global = true, value_name = "GIB", help_heading = "Files",
        value_parser = number_in(0.001..=1e6, "a number of GiB from 0.001 to 1000000")
    )]
    pub file_memory: Option<f64>,
    #[command(subcommand)]
    pub command: Command,
}

impl Cli {
    /// Parses a command line, in which every value may be a negative number; ends the process with the help or an
    /// error if it asks for help or cannot be parsed.
    pub(crate) fn of(arguments: impl IntoIterator<Item = OsString>) -> Self {
        let number = |arg: Arg| {
            let has_value = arg.get_action().takes_values();
            arg.allow_negative_numbers(has_value)
        };
        let command =
            Self::command().mut_args(number).mut_subcommands(|command| command.mut_args(number));
        let found = command.get_matches_from(arguments);
        Self::from_arg_matches(&found).unwrap_or_else(|error| error.exit())
    }
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Learn a stiffness field from touches
    Map(map::Args),
    /// Map beside a running robot, over ROS 2
    Live(live::Args),
    /// The network process that `palpate live` starts
    #[cfg(feature = "full")]
    #[command(hide = true)]
    LiveNetwork,
    /// Predict the torque of motions from a field, and compare it with the measured one
    Predict(predict::Args),
    /// Check whether touches contradict a field: the object moved, is softer or harder, or is another one
    Compare(compare::Args),
    /// Forget touches of a field, as if they had never been learnt
    Forget(forget::Args),
    /// Rank candidate motions by how much they would reduce the uncertainty about an object
    Next(next::Args),
    /// Compare estimators and baselines on touches that they have not seen: the paper's experiment
    Evaluate(evaluate::Args),
    /// Choose settings by cross-validation on your own touches
    Tune(tune::Args),
    /// Compare settings on several objects, and test on each object those chosen on the others
    Study(study::Args),
    /// Extrapolate stiffness to the points that a camera saw and no touch reached
    Extrapolate(extrapolate::Args),
    /// Map and predict bundled, simulated touches: a first look, without any data of your own
    Demo(demo::Args),
    /// Write a motion from which `palpate identify` can determine an arm's masses and friction
    Excite(excite::Args),
    /// Find payload, friction, bias and delay of an arm from logs of its free motion
    Identify(identify::Args),
    /// Compute external torques with standard deviations, and detect contacts
    Torque(torque::Args),
    /// Show the content of a log, a robot or a field, and what looks wrong with it
    Inspect(inspect::Args),
    /// Watch the arm, its contacts, the field and the torques in the Rerun viewer
    View(view::Args),
    /// Turn a log or a field into another format
    Convert(convert::Args),
    /// Measure how fast the mapper is on this machine
    Bench(bench::Args),
    /// Print the settings in effect, as a commented TOML file to start from
    Settings(AllSettings),
    /// Print completions for a shell
    Completions {
        /// The shell
        shell: Shell,
    },
}

/// A parser of numbers in a range; its error message says what is `wanted`.
pub(crate) fn number_in(
    range: RangeInclusive<f64>,
    wanted: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        number.ok_or_else(|| format!("wanted {wanted}"))
    }
}

/// Two corners of a box from six numbers.
pub(crate) fn corners(given: &[f64]) -> [[f64; 3]; 2] {
    [0, 3].map(|start| [0, 1, 2].map(|axis| given[start + axis]))
}

/// Prints a shell's completions.
pub(crate) fn completions(shell: Shell, output: &Output) -> Result<(), CliError> {
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), "palpate", &mut script);
    output.result(&String::from_utf8_lossy(&script))
}

/// `quick` or `off`.
pub(crate) fn quick_or_off(name: &str) -> Result<Tune, String> {
    let tune = Tune::named(name).ok().filter(|tune| *tune != Tune::Thorough);
    tune.ok_or_else(|| "wanted quick or off; `palpate tune` is more thorough".to_owned())
}
