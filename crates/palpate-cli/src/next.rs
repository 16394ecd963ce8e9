//! `palpate next`: which candidate motion to make next.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::ValueEnum;
use palpate::Arm;
use palpate_io::field;
use palpate_learn::next_touch::{Criterion, Proposal};
use palpate_work::csv;
use palpate_work::held_joints::of_field;
use palpate_work::next::{Proposals, RankingRequest, next};
use palpate_work::robot;
use palpate_work::touches::{RecordedTouch, Touches};

use crate::args::{corners, number_in};
use crate::error::CliError;
use crate::file_paths::{self, FilePaths};
use crate::interrupt;
use crate::output::{Output, table};
use crate::settings::RobotAndLogSettings;

const NOTES: &str = "Examples:
  palpate next field.npz --candidates planned/ --task reach.csv -o best.csv
  palpate next field.npz --candidates recordings/ --box 0.3 -0.1 0.4 0.5 0.1 0.6 --limit 8

A candidate is a log of any format, of which only the joint positions are used; a CSV needs no \
torques. Each proposal is the motion after which, together with the proposals before it, the \
least variance of the task remains. The task is the torques of the --task motions, the stiffness \
in the --box, or else the torques of all candidates. `left` is the share of the variance that \
remains after the motion. --by information ranks by the information that a motion gives about all \
cells that it touches, whatever the task, in nats (one nat: a quantity is known e times better).

--limit leaves out motions whose predicted torque may exceed it at a joint. If the field has an \
elastic body, the body is bent along each motion. The band for largest \
torques is added to the prediction (at 90 %, or the field's highest level if that is lower), or \
twice the standard deviation of the springs if the field has no bands (with an elastic body, the \
field must have bands). Positions between those of a motion are judged too. Cells that the field does \
not know may be stiffer.

Motions in which a joint exceeds its position limits in the URDF by more than 0.01 rad or m are \
not proposed. Limits of speed, held joints, and joints that follow another one are not checked.";

/// Flags of `palpate next`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
pub(crate) struct Args {
    /// The field so far
    #[arg(value_name = "FIELD.npz")]
    field: PathBuf,
    /// Candidate motions
    #[arg(long, required = true, num_args = 1.., value_name = "LOG")]
    candidates: Vec<PathBuf>,
    /// Motions whose torques are to be predicted well
    #[arg(long, num_args = 1.., value_name = "LOG", conflicts_with = "task_box")]
    task: Vec<PathBuf>,
    /// Box whose stiffness is to be known well, as far as candidates touch it: two corners, m
    #[arg(
        long = "box", id = "task_box", num_args = 6,
        value_names = ["X", "Y", "Z", "X", "Y", "Z"],
        value_parser = number_in(f64::MIN..=f64::MAX, "a finite coordinate, m")
    )]
    task_box: Option<Vec<f64>>,
    /// Criterion by which motions are ranked [default: variance]
    #[arg(long, value_name = "CRITERION")]
    by: Option<By>,
    /// Largest number of proposed motions [default: 5]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    count: Option<u32>,
    /// Largest torque of a joint that a motion may cause, N·m
    #[arg(long, value_name = "N_M", value_parser = number_in(1e-3..=1e6, "a torque from 0.001 to 1000000 N·m"))]
    limit: Option<f64>,
    /// Output file of the best motion, a table of times and joint positions
    #[arg(long, short, value_name = "FILE.csv")]
    output: Option<PathBuf>,
    /// Print the proposals as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: RobotAndLogSettings,
}

/// Criterion by which motions are ranked.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum By {
    /// Remaining variance of the task
    Variance,
    /// Information gained
    Information,
}

/// Ranks the candidates and writes the best.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let mut settings = args.settings.load()?;
    let logs = [args.candidates.as_slice(), &args.task].concat();
    let mut places = FilePaths::read(&args.settings, &settings, &logs);
    places.input("the field", Some(&args.field));
    places.output("the motion (--output)", args.output.as_deref())?;
    if let Some(path) = &args.output {
        file_paths::format_of(path, "file of a motion", &[("csv", ())])?;
    }
    interrupt::listen();
    let saved = field::load(&args.field).map_err(CliError::file)?;
    let arm = robot::load(&settings.robot, output)?;
    let own = of_field(Arc::clone(&arm), saved.snapshot.as_ref(), output);
    robot::warn_of_other_robot((&saved.robot, saved.snapshot.as_ref()), &own, output);
    let mut read = |logs: &[PathBuf], arm: &Arc<Arm>| -> Result<_, CliError> {
        let mut options = settings.log.options();
        options.planned = true;
        let mut touches = Touches::open(logs, &options)?;
        let arm = touches.arm_of_logs(Arc::clone(arm), &mut settings.robot, output)?;
        touches.angle_unit(&arm, &mut settings.clone(), output)?; // of these logs only
        let mut touches = touches.for_arm(&arm, &settings.log, saved.field.lattice.clone())?;
        Ok((touches.read(None)?, arm))
    };
    let (candidates, arm) = read(&args.candidates, &arm)?;
    let task = if args.task.is_empty() { Vec::new() } else { read(&args.task, &arm)?.0 };
    let request = RankingRequest {
        criterion: match args.by {
            Some(By::Information) => Criterion::Information,
            Some(By::Variance) | None => Criterion::Variance,
        },
        count: args.count.unwrap_or(5) as usize,
        limit_n_m: args.limit,
        box_m: args.task_box.as_deref().map(corners),
    };
    let found = next(&arm, &saved, (&candidates, &task), &request, output)?;
    if let Some(path) = &args.output {
        match found.proposals.first() {
            Some(best) => write(path, &candidates[best.candidate], &arm)?,
            None => {
                return Err(CliError::from(
                    "no motion can be proposed, so nothing was written".to_owned(),
                ));
            }
        }
    }
    if args.json { output.json(&found) } else { output.result(&text(&found, candidates.len())) }
}

/// Writes a motion as a table: times, if it has them, and joint positions.
fn write(path: &Path, motion: &RecordedTouch, arm: &Arm) -> Result<(), CliError> {
    let timed = motion.samples.iter().all(|sample| sample.time_s.is_some());
    let time = timed.then(|| "time".to_owned());
    let names = arm.robot.joint_names().map(|joint| format!("{joint}_position"));
    let head: Vec<String> = time.into_iter().chain(names).collect();
    let rows = motion.samples.iter().map(|sample| {
        let time = sample.time_s.filter(|_| timed).map(|time| format!("{time:.6}"));
        time.into_iter().chain(sample.q.iter().map(|q| format!("{q:.9}"))).collect()
    });
    file_paths::write(path, &csv::text(std::iter::once(head).chain(rows)))
}

/// The proposals as text; `candidates` is the number of all motions.
fn text(found: &Proposals, candidates: usize) -> String {
    if found.proposals.is_empty() {
        return format!("No motion can be proposed.\n{}", left_out(found));
    }
    let header = ["", "motion", "left", "information", "unknown", "torque N·m", "with band N·m"];
    let rows = found.proposals.iter().enumerate().map(|(number, own)| {
        let Proposal { torque_n_m: torque, with_band_n_m: most, .. } = &own.proposal;
        vec![
            format!("{}", number + 1),
            own.name.clone(),
            format!("{:.0} %", 100.0 * own.proposal.variance_left),
            format!("{:.0} nats", own.proposal.information_nats),
            format!("{:.0} %", 100.0 * own.proposal.unknown),
            format!("{torque:.2}"),
            // Without bands, both torques are the same.
            if most > torque { format!("{most:.2}") } else { "-".to_owned() },
        ]
    });
    format!(
        "Motions ranked by what they would teach, each given the ones above it. Left: remaining variance of the task.\n\
         Unknown: share of its touched cells that the field does not know. Torques: the largest at a joint.\n\n{}{}",
        table(&header, rows.collect::<Vec<_>>()),
        not_shown(found, candidates) + &left_out(found)
    )
}

/// How many motions could be proposed, but are not among the first `--count`.
fn not_shown(found: &Proposals, candidates: usize) -> String {
    let left_out =
        found.beyond_limit.len() + found.beyond_joint_limits.len() + found.touch_nothing.len();
    match candidates.saturating_sub(found.proposals.len() + left_out) {
        0 => String::new(),
        more => format!("\n{more} of {candidates} motions are not shown (--count).\n"),
    }
}

/// Motions that are not proposed, and why.
fn left_out(found: &Proposals) -> String {
    let mut text = String::new();
    if !found.beyond_limit.is_empty() {
        let each = found.beyond_limit.iter();
        let each = each.map(|own| format!("{} ({:.1} N·m)", own.name, own.with_band_n_m));
        text += &format!(
            "Torque with its band above --limit: {}.\n",
            each.collect::<Vec<_>>().join(", ")
        );
    }
    if !found.beyond_joint_limits.is_empty() {
        let each = found.beyond_joint_limits.iter().map(|own| {
            let ([low, high], at) = (own.limits, own.position);
            format!("{} ({} at {at:.3}, limits {low:.3} .. {high:.3})", own.name, own.joint)
        });
        text += &format!("Beyond joint limits: {}.\n", each.collect::<Vec<_>>().join(", "));
    }
    if !found.touch_nothing.is_empty() {
        text += &format!("Without contact: {}.\n", found.touch_nothing.join(", "));
    }
    text
}
