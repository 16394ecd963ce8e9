//! `palpate bench`: how fast the mapper is on this machine.
//!
//! | file        | content                                                                  |
//! |-------------|--------------------------------------------------------------------------|
//! | `recording` | a log held in memory, and the passes through it                          |
//! | `whole`     | the step as a user runs it                                               |
//! | `parts`     | the same step in two parts, on one thread                                |
//! | `answers`   | how long it takes to predict the torque of a path                        |
//! | `peak`      | the peak memory of the process                                           |
//! | `figures`   | all results, as JSON and as text                                         |
//!
//! The crate `palpate-bench` runs this command for lattices of several sizes, and compares the times
//! with the lower bounds set by the machine's memory and arithmetic.
//!
//! # Protocol
//!
//! The log is learnt `--warm-passes` times before the clock starts, so that memory is as full as
//! in use, then `--passes` times with the clock running. Timed are the steps that learn: their tare is
//! known, and they touch something. This is done twice, first with a mapper and then with its parts.
//! The peak memory is read after the passes of the mapper, before anything else is allocated.
//!
//! The command does not wait for the machine to be idle: read the figures as ratios, and compare them
//! only within a run.

mod answers;
mod figures;
mod parts;
mod peak;
mod recording;
mod whole;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use palpate::{Arm, MapperConfig};
use palpate_work::touches::RecordedTouch;

use self::figures::Figures;
use self::recording::{Passes, at_least_one};
use self::whole::Whole;
use crate::error::CliError;
use crate::output::Output;
use crate::pace::PaceArgs;
use crate::settings::{AllSettings, Settings};
use crate::{bundled, interrupt, logs};

const EXAMPLES: &str = "Examples:
  palpate bench                              the bundled, simulated touches
  palpate bench recordings/ --robot panda.urdf --gravity removed
  palpate bench --estimator ekf --json
  palpate bench --rate 17 --touches 2        how many replays fit into a step at 17 Hz?
  palpate bench data/plant_a/seq_00* --answers data/plant_a/seq_010

The log is learnt once before the clock starts (--warm-passes), so that memory is as full as in \
use, and once with the clock running (--passes). Steps are timed if their tare is known and they \
touch something. The whole step is timed as a user runs it; its two parts, the simulator and the \
update with its replays, are timed on one thread.

With --rate the passes run in real time. The step is then timed without replays, and the number \
of replays that fitted into the remaining time is reported; it depends on the machine. The parts \
are measured with the replays of the settings, whatever the rate.

With --answers, the mapper that has learnt the log predicts the torque along other touches, as \
`palpate live --ask` does. The result is compared with the exact one, of every spring at every \
point. Give touches that are not in the log.";

/// Flags of `palpate bench`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// Logs to learn from; without any, the bundled touches, which are simulated
    #[arg(value_name = "LOG")]
    logs: Vec<PathBuf>,
    #[command(flatten)]
    passes: Passes,
    /// Only the first N touches of the log [default: all]
    #[arg(long, value_name = "N", value_parser = at_least_one())]
    touches: Option<u32>,
    /// Also time the prediction of torques along the paths of these touches, in 200 points each
    #[arg(long, value_name = "LOG")]
    answers: Vec<PathBuf>,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    pace: PaceArgs,
    #[command(flatten)]
    settings: AllSettings,
}

/// Measures, and prints what was found.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let started = Instant::now();
    let mut settings = args.settings.load_without_body()?;
    settings.config()?;
    interrupt::listen();
    let figures = Bench::prepare(args, &mut settings, output)?.measure(started, output)?;
    if args.json { output.json(&figures) } else { output.result(&figures.text()) }
}

/// Everything that a measurement needs.
struct Bench<'a> {
    args: &'a Args,
    arm: Arc<Arm>,
    config: MapperConfig,
    /// The touches to learn from.
    recording: Vec<RecordedTouch>,
    /// The touches of `--answers`.
    asked: Vec<RecordedTouch>,
}

impl<'a> Bench<'a> {
    fn prepare(args: &'a Args, settings: &mut Settings, output: &Output) -> Result<Self, CliError> {
        let bundled; // lives until all is read
        let paths = match args.logs.as_slice() {
            [] => {
                bundled = bundled::unpack()?;
                &bundled.touches
            }
            given => given,
        };
        let (touches, arm) = logs::open(paths, settings, logs::IfUndecided::Refuse, output)?;
        let recording = touches.read_to_learn(&arm, settings, args.touches, output)?;
        let asked = logs::open_more(&args.answers, settings, &arm)?;
        let asked = asked.read_to_learn(&arm, settings, None, output)?;
        logs::note_robot(&arm, settings, output);
        Ok(Self { args, arm, config: settings.config()?, recording, asked })
    }

    /// The figures of this configuration.
    fn measure(&self, started: Instant, output: &Output) -> Result<Figures, CliError> {
        let whole = Whole::new(self, started)?.measure(self, output)?;
        let mut figures = whole.ok_or_else(|| self.touches_nothing())?;
        figures.parts = parts::measure(self, output)?;
        Ok(figures)
    }

    /// The error if no step of the log can be timed.
    fn touches_nothing(&self) -> CliError {
        let names: Vec<_> =
            self.args.logs.iter().map(|log| format!("`{}`", log.display())).collect();
        let log =
            if names.is_empty() { "the bundled touches".to_owned() } else { names.join(", ") };
        let touches = match self.recording.len() {
            1 => "the only touch".to_owned(),
            touches => format!("{touches} touches"),
        };
        CliError::from(format!(
            "there is nothing to time: in {touches} of {log} no step touches a point of the lattice \
             once its tare is known; check --robot, the joints' unit (--angle-unit) and the \
             workspace box (--box-low-m, --box-high-m), or take more touches; `palpate inspect` \
             says what the log holds"
        ))
    }
}
