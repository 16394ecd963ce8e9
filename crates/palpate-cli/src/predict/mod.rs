//! `palpate predict`: the torques that a field predicts for motions, and the measured ones.
//!
//! [`run`] is the command; [`score`] predicts the touches; [`report`] is what is printed; [`export`]
//! writes the torques themselves.

mod export;
mod report;

use std::path::PathBuf;
use std::sync::Arc;

use palpate::{Arm, ExternalTorqueConfig};
use palpate_io::field::{self, SavedField};
use palpate_work::predict::{ReferenceTorque, score};
use palpate_work::prediction_report::{PredictionReport, report_oddities};
use palpate_work::robot;
use palpate_work::touches::Touches;

use crate::error::CliError;
use crate::file_paths::FilePaths;
use crate::output::Output;
use crate::settings::{RobotLogAndTouchSettings, Settings};
use crate::{interrupt, logs, picture};

pub(crate) use report::{bands, text};

const NOTES: &str = "Examples:
  palpate predict field.npz recordings/seq_010
  palpate predict field.npz plant_a/ --truth --picture torques.svg -o torques.csv

Errors are those of the paper's Table I: the error of a frame is |predicted - measured| over all \
joints, in N·m; the relative error is that divided by |measured|, on frames of at least 1 N·m. \
Frames after the tare are scored. `overall` pools the frames of all touches. The error of \
predicting zero is given for comparison: a field with a larger error is worse than none.

Lattice, contact model and torque convention (sign, gravity, tare) are those of the field. Flags \
and a settings file may change the robot, the log's format and the torque convention for this \
log; other sections of a settings file are not used here.

--json prints {\"touches\": [{\"name\", \"frames\", avg_error, max_error, avg_relative, \
max_relative, \"zero\": {the same four}}], \"overall\": {...}}, errors in N·m, relative ones null \
where no frame reaches 1 N·m; `frames` are those scored.";

/// Flags of `palpate predict`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
pub(crate) struct Args {
    /// The field that predicts
    #[arg(value_name = "FIELD.npz")]
    field: PathBuf,
    /// Logs of the motions to predict
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Score against the true torques in truth/ beside the touches, which simulated logs have, instead of
    /// the measured ones
    #[arg(long)]
    truth: bool,
    /// Output file of the predicted and measured torques of all frames
    #[arg(long, short, value_name = "FILE.csv|FILE.npz")]
    output: Option<PathBuf>,
    /// Draw predicted and measured torques, with the bands of the joints
    #[arg(long, value_name = "FILE.svg|FILE.png")]
    picture: Option<PathBuf>,
    /// Print the errors as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: RobotLogAndTouchSettings,
}

impl Args {
    /// Refuses outputs that cannot be written, or would replace an input or another output.
    fn check_places(&self, settings: &Settings) -> Result<(), CliError> {
        let mut places = FilePaths::read(&self.settings, settings, &self.logs);
        places.input("the field", Some(&self.field));
        places.output("the torques (--output)", self.output.as_deref())?;
        places.output("the picture (--picture)", self.picture.as_deref())
    }
}

/// Predicts the touches of logs and prints the errors.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let mut settings = args.settings.load()?;
    let export = args.output.as_deref().map(export::Format::of).transpose()?;
    args.check_places(&settings)?;
    let picture = args.picture.as_deref().map(picture::Format::of).transpose()?;
    interrupt::listen();
    let saved = field::load(&args.field).map_err(CliError::file)?;
    let (mut touches, arm, touch) = open_beside(&saved, &args.logs, &mut settings, output)?;
    let against = if args.truth { ReferenceTorque::Truth } else { ReferenceTorque::Measured };
    let learnt = (&saved.field, saved.snapshot.as_ref());
    let results = score(&arm, learnt, touch, against, (&mut touches, output))?;

    if let (Some(path), Some(format)) = (&args.output, export) {
        format.write(path, &results, &saved.field)?;
    }
    if let (Some(path), Some(format)) = (&args.picture, picture) {
        format.write(path, &picture::torques(&results, (&saved.field, against))?)?;
    }
    let report = PredictionReport::new(&results, (&saved.field, against));
    report_oddities(&results, &saved.field, output);
    if args.json { output.json(&report) } else { output.result(&text(&report)) }
}

/// Opens logs that are compared with a field; also returns their arm and torque convention.
pub(crate) fn open_beside(
    saved: &SavedField,
    logs: &[PathBuf],
    settings: &mut Settings,
    output: &Output,
) -> Result<(Touches, Arc<Arm>, ExternalTorqueConfig), CliError> {
    let (touches, arm) = logs::open(logs, settings, logs::IfUndecided::LeaveOpen, output)?;
    robot::warn_of_other_robot((&saved.robot, saved.snapshot.as_ref()), &arm, output);
    let touch = settings.torque_convention_for_field(&saved.field.touch)?;
    let lattice = saved.field.lattice.clone();
    Ok((touches.for_arm(&arm, &settings.log, lattice)?, arm, touch))
}
