//! `palpate bench`: how fast the mapper is on this machine.
//!
//! | file        | content                                                                  |
//! |-------------|--------------------------------------------------------------------------|
//! | `recording` | a log held in memory, and the passes through it                          |
//! | `whole`     | the step as a user runs it                                               |
//! | `parts`     | the same step in two parts, on one thread                                |
//! | `answers`   | how long it takes to predict the torque of a path                        |
//! | `peak`      | the most memory that the process has held                                |
//! | `figures`   | all of it, as JSON and as text                                           |
//!
//! The crate `palpate-bench` runs this command for lattices of several sizes, and compares it with
//! what the machine's memory and arithmetic allow.
//!
//! # Protocol
//!
//! The log is learnt `--warm-passes` times before the clock starts, so that memory is as full as
//! in use, then `--passes` times with the clock running. Timed are the steps whose tare is known
//! and which touch something: those that learn. This is done twice, with a mapper and with its
//! parts. The peak of memory is read after the mapper and before anything else is made.
//!
//! Nothing here judges: budgets are the reader's. Nothing waits for the machine to be idle either,
//! so figures are to be read as ratios, and compared only within a run.

mod answers;
mod figures;
mod parts;
mod peak;
mod recording;
mod whole;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use palpate::{Arm, MapperConfig};

use self::figures::Figures;
use self::recording::{Passes, Recording};
use crate::bundled::{self, Unpacked};
use crate::error::CliError;
use crate::output::Output;
use crate::pace::PaceArgs;
use crate::settings::{AllSettings, Settings, SettingsError};
use crate::touches::Touches;
use crate::{interrupt, robot};

const EXAMPLES: &str = "Examples:
  palpate bench                              the bundled, simulated touches
  palpate bench recordings/ --robot panda.urdf --gravity removed
  palpate bench --estimator ekf --json
  palpate bench --rate 17 --touches 2        how many replays fit into a step at 17 Hz?
  palpate bench data/plant_a/seq_00* --answers data/plant_a/seq_010

The log is learnt once before the clock starts (--warm-passes), so that memory is as full as in
use, and once with the clock running (--passes). Timed are the steps whose tare is known and which
touch something. The whole step is timed as a user runs it; its two parts, the simulator and the
update with its replays, are timed on one thread.

With --rate the passes take real time. Timed is then the step without replays, and reported is how
many replays fitted into what it left; that depends on the machine. The parts are measured with
the replays of the settings, whatever the rate.

With --answers the mapper that has learnt the log is asked what torque the touches of another would
meet, as `palpate live --ask` answers, and how far that is from the answer of every spring at every
point. Give touches that it has not learnt.";

/// Flags of `palpate bench`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// Logs to learn from; without any, the bundled touches, which are simulated
    #[arg(value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Passes through the log before the clock starts
    #[arg(long, value_name = "N", default_value_t = 1)]
    warm_passes: u32,
    /// Passes through the log with the clock running
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = at_least_one())]
    passes: u32,
    /// Only the first N touches of the log [default: all]
    #[arg(long, value_name = "N", value_parser = at_least_one())]
    touches: Option<u32>,
    /// Also time answers about the paths of these touches, in 200 points each
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

fn at_least_one() -> clap::builder::RangedI64ValueParser<u32> {
    clap::value_parser!(u32).range(1..)
}

/// Measures, and prints what was found.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let started = Instant::now();
    let mut settings = args.settings.load()?;
    settings.config()?;
    interrupt::listen();
    let figures = Bench::prepare(args, &mut settings, output)?.measure(started, output)?;
    if args.json { output.json(&figures) } else { output.result(&figures.text()) }
}

/// Where the touches come from.
enum Logs<'a> {
    Given(&'a [PathBuf]),
    Bundled(Unpacked),
}

impl Logs<'_> {
    fn paths(&self) -> &[PathBuf] {
        match self {
            Self::Given(paths) => paths,
            Self::Bundled(files) => &files.touches,
        }
    }
}

/// Everything that a measurement needs.
struct Bench<'a> {
    args: &'a Args,
    logs: Logs<'a>,
    arm: Arc<Arm>,
    config: MapperConfig,
    recording: Recording,
    /// What is asked about.
    asked: Option<Recording>,
}

impl<'a> Bench<'a> {
    fn prepare(args: &'a Args, settings: &mut Settings, output: &Output) -> Result<Self, CliError> {
        let logs = match args.logs.as_slice() {
            [] => Logs::Bundled(bundled::unpack()?),
            given => Logs::Given(given),
        };
        let touches = Touches::open(logs.paths(), &settings.log.options())?;
        touches.gravity_of_logs(&mut settings.touch, output)?;
        let config = settings.config()?;
        let arm = robot::load(&settings.robot, output)?;
        settings.log.check_for(&arm.robot)?;
        let place = (config.lattice.clone(), config.contact.clone());
        let read = |touches: Touches, most| {
            let mut touches = touches.for_arm(&arm, &settings.log, place.clone())?;
            let recording = Recording::read(&mut touches, most)?;
            touches.tell_warnings(output);
            Ok::<_, CliError>(recording)
        };
        let recording = read(touches, args.touches)?;
        let asked = match args.answers.as_slice() {
            [] => None,
            logs => Some(read(Touches::open(logs, &settings.log.options())?, None)?),
        };
        output.note(&format!("robot {}, {} joints", settings.robot.name(), arm.robot.n_joints()));
        Ok(Self { args, logs, arm, config, recording, asked })
    }

    /// The figures of this configuration.
    fn measure(&self, started: Instant, output: &Output) -> Result<Figures, CliError> {
        let out_of_range = |error| SettingsError::Value(Box::new(error));
        let pace = self.args.pace.pace(&self.config);
        let mapper = whole::Whole::new(&self.arm, self.config.clone(), pace, started)
            .map_err(out_of_range)?;
        let passes = Passes { warm: self.args.warm_passes, timed: self.args.passes };
        let whole = mapper.measure(&self.recording, passes, self.asked.as_ref(), output)?;
        if whole.step_ms.is_empty() {
            return Err(self.touches_nothing());
        }
        let parts = parts::measure(&self.arm, &self.config, &self.recording, passes, output)?;
        Ok(Figures::new(self, &whole, &parts))
    }

    /// The log was of no use.
    fn touches_nothing(&self) -> CliError {
        let log = match &self.logs {
            Logs::Given(paths) => {
                let names: Vec<_> = paths.iter().map(|path| Path::display(path)).collect();
                names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
            }
            Logs::Bundled(_) => "the bundled touches".to_owned(),
        };
        CliError::from(format!(
            "there is nothing to time: in {} of {log} no step touches a point of the lattice once \
             its tare is known; check --robot, the joints' unit (--angle-unit) and the workspace \
             box (--box-low-m, --box-high-m), or take more touches; `palpate inspect` says what \
             the log holds",
            match self.recording.touches() {
                1 => "the only touch".to_owned(),
                touches => format!("{touches} touches"),
            }
        ))
    }
}
