//! `palpate map`: learns a field from touches.

use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use palpate::unstable::{ElasticBody, ElasticModel};
use palpate::{Arm, Calibration, EstimatorKind, Mapper, Sample, StepReport};
use palpate_io::field::{self, SavedField};
use palpate_work::Progress;
use palpate_work::elastic;
use palpate_work::learn::{CellCounts, ErrorsAndZero, LearningSummary, learn};
use palpate_work::settings::sections::RobotSettings;
use palpate_work::tune::{Tune, quickly_tuned};
use palpate_work::{prior, resume};
use serde_json::json;

use crate::args::quick_or_off;
use crate::error::CliError;
use crate::file_paths::FilePaths;
use crate::object_args::ObjectArgs;
use crate::output::{Output, mib, rows, seconds};
use crate::pace::{self, Pace, PaceArgs, PaceFigures};
use crate::settings::{AllSettings, Settings};
use crate::{file_paths, interrupt, logs, picture};

const EXAMPLES: &str = "Examples:
  palpate map recordings/ -o field.npz
  palpate map recordings/ -o field.npz --friction 0.2 --tune=off
  palpate map monday/ tuesday/ -o field.npz --robot panda.urdf --gravity removed
  palpate map wednesday/ -o field.npz --from field.npz
  palpate map today/ -o field.npz --prior yesterday.npz
  palpate map recordings/ -o field.npz --estimator elastic --cloud object.ply
  palpate map recordings/ -o field.npz --rate 17

A LOG is a folder of one touch (angles.npy, torques.npy), a folder of such folders, a .csv file \
or a folder of them, a bag of ROS 2 (MCAP, SQLite) or Parquet.

`map` chooses contact distance, friction, Coulomb friction, prior and stiffness scale by \
cross-validation on at most 16 touches, those with the largest torques. Settings that a flag or \
--settings gives are not chosen. This needs at least three touches, and takes 20 seconds for \
eleven touches on two cores. With fewer touches, with --tune=off, and for all other settings the \
defaults are used; `palpate settings` prints them.

The file of the field contains the memory of its touches, so that --from continues exactly where \
mapping stopped.

--prior starts a new field, with the stiffness of another field as the prior mean of each cell: \
its own prior mean (`K_prior`) if it has one, else what it has learnt (`K`). The lattice must be \
the same.

--cloud makes an elastic body from a coloured cloud of the object (estimator `elastic`). The body \
and the field then predict together. --from needs no cloud: the file contains the body and its \
touches. Without a LOG the body has the typical stiffness of other plants. With --from and \
without a LOG, it learns the touches in a field of `palpate live` that the body has not learnt \
yet.

--rate learns as if beside a robot that reports at this rate: every step uses its remaining time \
for replays. The field then depends on the speed of the machine, and differs a little from run to \
run; without --rate the same log and settings give the same field.";

/// Flags of `palpate map`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub(crate) struct Args {
    /// Logs to learn from, in this order
    #[arg(required_unless_present_any = ["cloud", "body", "from"], value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Output file of the field; an existing file is replaced once the new one is complete
    #[arg(long, short, value_name = "FIELD.npz")]
    output: PathBuf,
    /// Continue mapping from a saved field, with its settings
    #[arg(long, value_name = "FIELD.npz", conflicts_with_all = ["cloud", "body"])]
    from: Option<PathBuf>,
    /// Take the prior mean of each cell from a field, in place of one prior mean for all
    #[arg(long, value_name = "FIELD.npz", conflicts_with_all = ["cloud", "body"])]
    prior: Option<PathBuf>,
    /// Whether settings that are not given are chosen by cross-validation: `quick` or `off` [default: quick; off with
    /// --from, --prior, --cloud or --estimator ekf]
    #[arg(
        long, value_name = "HOW", num_args = 0..=1, default_missing_value = "quick",
        require_equals = true, value_parser = quick_or_off
    )]
    tune: Option<Tune>,
    /// Leave out the memory: a smaller file, which --from cannot continue
    #[arg(long)]
    no_memory: bool,
    /// On Ctrl-C, save the field so far
    #[arg(long)]
    save_on_interrupt: bool,
    /// Draw the field from three sides
    #[arg(long, value_name = "FILE.svg|FILE.png")]
    picture: Option<PathBuf>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    object: ObjectArgs,
    #[command(flatten)]
    pace: PaceArgs,
    #[command(flatten)]
    settings: AllSettings,
}

impl Args {
    /// Whether settings are chosen by cross-validation.
    fn is_tuned(&self, settings: &Settings) -> Result<bool, CliError> {
        let begins_with = self.from.is_some() || self.prior.is_some() || self.object.is_given();
        match self.tune {
            Some(Tune::Quick) if begins_with => Err(CliError::Usage(
                "settings are not chosen with --from, --prior, --cloud or --body; leave out --tune"
                    .to_owned(),
            )),
            Some(tune) => Ok(tune == Tune::Quick),
            None => Ok(!begins_with && settings.config()?.method == EstimatorKind::Map),
        }
    }

    /// Refuses outputs that cannot be written, or would replace an input or another output.
    fn check_places(&self, settings: &Settings) -> Result<(), CliError> {
        let mut places = FilePaths::read(&self.settings, settings, &self.logs);
        places.input("the prior (--prior)", self.prior.as_deref());
        self.object.add_to(&mut places);
        places.output("the field (--output)", Some(&self.output))?;
        // Only --output may name the same file as --from.
        places.input("the field to go on from (--from)", self.from.as_deref());
        places.output("the picture (--picture)", self.picture.as_deref())
    }
}

/// Learns a field and saves it.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let started = Instant::now();
    if args.prior.is_some() && args.from.is_some() {
        return Err(CliError::Usage(
            "--prior and --from exclude each other: the field to continue from already has its prior; \
             leave out --prior, or leave out --from to start a new field"
                .to_owned(),
        ));
    }
    let mut settings = args.settings.load()?;
    let robot = settings.robot.clone();
    args.object.select(&mut settings, args.from.is_some())?;
    if args.from.is_none() {
        settings.config()?;
    }
    let is_tuned = args.is_tuned(&settings)?;
    args.check_places(&settings)?;
    let format = args.picture.as_deref().map(picture::Format::of).transpose()?;
    interrupt::listen();
    let _hold = file_paths::hold_field(&args.output)?;
    let (bodies, _) = args.object.bodies(output)?;
    let mut elastic = (!bodies.is_empty()).then_some(Elastic { bodies, touches: Vec::new() });
    let if_undecided =
        if args.from.is_some() { logs::IfUndecided::LeaveOpen } else { logs::IfUndecided::Refuse };
    let (touches, arm) = logs::open(&args.logs, &mut settings, if_undecided, output)?;
    let (mut mapper, mut pace) = begin(args, (&arm, &settings, is_tuned), &mut elastic, output)?;
    logs::note_robot(&arm, &settings, output);
    let lattice = mapper.config().lattice.clone();
    let mut touches = touches.for_arm(&arm, &settings.log, lattice)?;
    let mut fill = |mapper: &mut Mapper, report: &StepReport, started: Instant| {
        if let Some(pace) = &mut pace {
            pace.fill(mapper, report, started);
        }
    };
    let record = elastic.as_mut().map(|elastic| &mut elastic.touches);
    let tally = learn(&mut mapper, &mut touches, &mut fill, record, output)?;
    if let Some(place) = &tally.interrupted {
        return Err(stop(args, (&mapper, elastic.is_some()), place)?);
    }

    let saved = match elastic {
        Some(Elastic { bodies, touches }) => {
            elastic::learn_body(&mapper, &bodies, touches, output)?
        }
        None => SavedField::of_mapper(&mapper),
    };
    let saved = save(args, saved)?;
    if let (Some(path), Some(format)) = (&args.picture, format) {
        format.write(path, &picture::field(&saved.field)?)?;
    }
    warn_if_worse_than_zero(args, &tally, output);
    let pace = pace.as_ref().map(Pace::figures);
    let (cells, body) = (CellCounts::of(&mapper), saved.field.elastic.as_deref());
    let summary =
        Summary { args, robot: &robot, mapper: &mapper, tally: &tally, cells, pace, body };
    if args.json {
        output.json(&summary.json(started.elapsed()))
    } else {
        output.result(&summary.text(started.elapsed()))
    }
}

/// Warns if the field predicted the frames that came next worse than zero does.
fn warn_if_worse_than_zero(args: &Args, tally: &LearningSummary, output: &Output) {
    let ErrorsAndZero { errors, zero } = tally.before_learning();
    if let (Some(error), Some(zero)) = (errors.avg_error, zero.avg_error)
        && error > 1.05 * zero
    {
        let why = match args.from.is_some() || args.prior.is_some() {
            true => {
                "the field that it began with may be that of another, moved or changed object; see `palpate compare`"
            }
            false => {
                "these may not be torques of an object, but friction, inertia or bias; `palpate inspect` and `palpate \
                 identify` find these"
            }
        };
        output.warn(&format!(
            "while it learned, the field predicted the next frame worse than zero does ({error:.3} against {zero:.3} \
             N·m): {why}"
        ));
    }
}

/// What the field's bands were calibrated on.
fn calibrated_on(calibration: Option<&Calibration>) -> String {
    match calibration {
        Some(own) => {
            let highest = 100.0 * own.highest_level();
            let on = match own.of_other_objects {
                true => "calibrated on other objects".to_owned(),
                false => format!("calibrated on {} touches", own.touches),
            };
            format!("up to {highest:.0} %, {on}")
        }
        None => "none: nothing was touched".to_owned(),
    }
}

/// The data from which an elastic body is learnt.
struct Elastic {
    /// The candidate bodies of the object.
    bodies: Vec<Arc<ElasticBody>>,
    /// Samples of the touches so far.
    touches: Vec<Vec<Sample>>,
}

/// A new mapper, or one that continues from a field; and its pace if `--rate` is given.
fn begin(
    args: &Args,
    (arm, settings, is_tuned): (&Arc<Arm>, &Settings, bool),
    elastic: &mut Option<Elastic>,
    output: &Output,
) -> Result<(Mapper, Option<Pace>), CliError> {
    let mapper = match &args.from {
        Some(path) => {
            let mut saved = field::load(path).map_err(CliError::file)?;
            if let Some(model) = saved.field.elastic.take() {
                let bodies = model.bodies();
                *elastic = Some(Elastic { bodies, touches: saved.elastic_touches.split_off(0) });
            }
            let name = path.display();
            let snapshot = resume::snapshot_of(saved, &name.to_string(), arm, settings)?;
            if args.logs.is_empty() && elastic.as_ref().is_none_or(|body| body.touches.is_empty()) {
                return Err(CliError::Usage(format!(
                    "there is nothing to learn: `{name}` holds no touches for an elastic body; give LOGs"
                )));
            }
            resume::mapper(&name, arm, snapshot, output)?
        }
        None => {
            let (mut config, mut calibration) = (settings.config()?, None);
            if is_tuned {
                let touches = logs::open_more(&args.logs, settings, arm)?.with_noted_time_units();
                let chosen = quickly_tuned(touches, (arm, settings, &config), output)?;
                (config, calibration) = (chosen.config, chosen.calibration);
            }
            prior::mapper(args.prior.as_deref(), arm, config, output)?.with_calibration(calibration)
        }
    };
    Ok(args.pace.keep(mapper))
}

/// Saves the field, and returns what was saved.
fn save(args: &Args, mut saved: SavedField) -> Result<SavedField, CliError> {
    if args.no_memory {
        (saved.snapshot, saved.elastic_touches) = (None, Vec::new());
    }
    file_paths::save(&args.output, &saved)?;
    Ok(saved)
}

/// After Ctrl-C: saves the field if requested, and returns the error that says what was done.
///
/// A field whose body was not learnt yet is not saved: mapping could not go on from it with the body.
fn stop(
    args: &Args,
    (mapper, has_body): (&Mapper, bool),
    place: &str,
) -> Result<CliError, CliError> {
    let kept = if has_body {
        format!(" at {place}; nothing was written, since the elastic body was not learnt yet")
    } else if args.save_on_interrupt {
        save(args, SavedField::of_mapper(mapper))?;
        format!(" at {place}; the field so far is in `{}`", args.output.display())
    } else {
        format!(" at {place}; nothing was written (--save-on-interrupt saves the field so far)")
    };
    Ok(CliError::Interrupted { kept })
}

/// The summary that is printed at the end.
struct Summary<'a> {
    args: &'a Args,
    robot: &'a RobotSettings,
    mapper: &'a Mapper,
    tally: &'a LearningSummary,
    cells: CellCounts,
    pace: Option<PaceFigures>,
    body: Option<&'a ElasticModel>,
}

impl Summary<'_> {
    fn next_command(&self) -> String {
        let robot = logs::robot_flags(self.robot);
        let field = self.args.output.display().to_string();
        format!("palpate predict {} LOG{robot}", logs::quoted(&field))
    }

    /// The calibration of the field's bands.
    fn calibration(&self) -> Option<&Calibration> {
        match self.body {
            Some(model) => model.calibration.as_ref(),
            None => self.mapper.calibration(),
        }
    }

    fn json(&self, elapsed: Duration) -> serde_json::Value {
        let mut json = self.tally.figures(self.mapper);
        json["field"] = json!(self.args.output);
        json["seconds"] = json!(elapsed.as_secs_f64());
        json["bands"] = self.calibration().map_or(serde_json::Value::Null, |own| {
            json!({
                "highest_level": own.highest_level(),
                "touches": own.touches,
                "of_other_objects": own.of_other_objects,
            })
        });
        json["pace"] = json!(self.pace);
        json["elastic"] = self.body.map_or(serde_json::Value::Null, |model| {
            json!({
                "share": model.share,
                "friction": model.friction,
                "creep_s": model.creep_s,
                "stiffness_factors": model.likeliest().stiffness_factors,
            })
        });
        json["next"] = json!(self.next_command());
        json
    }

    fn text(&self, elapsed: Duration) -> String {
        let (tally, config) = (self.tally, self.mapper.config());
        let (frames_remembered, bytes) = self.mapper.memory();
        let mut found = vec![
            ("estimator", config.method.name().to_owned()),
            ("touches", tally.touches.len().to_string()),
            ("frames", tally.total(|touch| touch.frames).to_string()),
            (
                "of them at the start, not learnt",
                tally.total(|touch| touch.tare_frames).to_string(),
            ),
            ("contacts (median in contact)", tally.contacts_median().to_string()),
            ("cells touched", self.cells.touched.to_string()),
        ];
        if self.cells.expected > 0 {
            let CellCounts { expected, expected_and_touched, .. } = self.cells;
            let cells = format!("{expected}, {expected_and_touched} of them touched");
            found.push(("cells expected by the prior", cells));
        }
        found.push(("frames remembered", format!("{frames_remembered} in {}", mib(bytes))));
        if let Some(model) = self.body {
            found.push(("weight of the elastic body", format!("{:.0} %", 100.0 * model.share)));
            let factors = &model.likeliest().stiffness_factors;
            let factors: Vec<String> =
                factors.iter().map(|factor| format!("{factor:.2}")).collect();
            found.push(("its stiffness factor", factors.join(", ")));
            let creep = if model.creep_s > 0.0 { "contacts creep" } else { "no creep" };
            found.push(("its friction", format!("{}, {creep}", model.friction)));
        } else if config.method == EstimatorKind::Elastic {
            found.push(("elastic body", "none, map is used alone".to_owned()));
        }
        let bands = match self.body {
            Some(body) if body.calibration.is_none() && body.n_touches > 0 => {
                "none: the field has extrapolated stiffness".to_owned()
            }
            _ => calibrated_on(self.calibration()),
        };
        found.push(("bands", bands));
        found.push(("time", seconds(elapsed)));
        found.extend(self.pace.as_ref().map(|pace| ("pace", pace.text())));
        let before = tally.before_learning();
        if let (Some(map), Some(zero)) = (before.errors.avg_error, before.zero.avg_error) {
            let error = format!("{map:.3} N·m on average (predicting zero: {zero:.3} N·m)");
            found.push(("error before learning a frame", error));
        }
        let mut text = format!("The field is in `{}`.\n", self.args.output.display());
        text += &rows(&found);
        if self.pace.is_some() {
            let _ = writeln!(text, "{}", pace::ORIGIN);
        }
        if let Some(path) = &self.args.picture {
            let _ = writeln!(text, "The picture is in `{}`.", path.display());
        }
        let _ = writeln!(text, "Next: {}", self.next_command());
        text
    }
}
