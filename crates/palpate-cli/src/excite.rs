//! `palpate excite`: a motion for `palpate identify`.

use std::fmt::{Display, Write};
use std::path::PathBuf;

use palpate::Robot;
use palpate_learn::excite::{Excitation, ExciteConfig, excite};
use palpate_work::quantile::extremes;
use palpate_work::settings::sections::RobotSettings;
use palpate_work::{Progress, held_joints, robot};
use serde_json::json;

use crate::args::number_in;
use crate::error::CliError;
use crate::file_paths::{self, FilePaths};
use crate::output::Output;
use crate::settings::{RobotOnlySettings, Settings};
use crate::{csv, interrupt, logs};

const NOTES: &str = "Examples:
  palpate excite --robot fr3.urdf --start 0,-0.785,0,-2.356,0,1.571,0.785 -o motion.csv
  palpate excite --robot ur10e.urdf --ground-m 0.1 --speed 0.3 --rate-hz 10 -o motion.yaml
  ros2 topic pub -1 /joint_trajectory_controller/joint_trajectory \\
    trajectory_msgs/msg/JointTrajectory \"$(cat motion.yaml)\"

The motion begins and ends at rest at --start. It respects the joints' limits of position, speed \
and torque, and avoids the ground and self-collision; links that are closer than 3 cm to each \
other at the start count as neighbours, whose distance is not checked. Other obstacles are not \
known: play the motion slowly first (--slow-down 10), with a hand on the emergency stop. For \
`ros2 topic pub`, use --rate-hz 10 and no --slow-down: Linux accepts at most 128 KiB in one \
argument. Another --seed gives another motion. Log the motion, and give the log to `palpate \
identify`; three motions of different seeds determine the arm better than one.";

/// Flags of `palpate excite`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
pub(crate) struct Args {
    /// Output file of the motion: a table, or a trajectory_msgs/JointTrajectory
    #[arg(long, short, value_name = "FILE.csv|.yaml")]
    output: PathBuf,
    /// Joint positions where the motion begins and ends, rad or m, without those of a gripper
    /// [default: the middle of each range]
    #[arg(long, value_name = "Q1,Q2,…", value_delimiter = ',', allow_hyphen_values = true)]
    start: Option<Vec<f64>>,
    /// Duration of the motion, s [default: 20]
    #[arg(long, value_name = "S", value_parser = number_in(5.0..=600.0, "a number of seconds from 5 to 600"))]
    duration: Option<f64>,
    /// Points per second [default: 100]
    #[arg(long, value_name = "HZ", value_parser = number_in(5.0..=2000.0, "a rate from 5 to 2000 Hz"))]
    rate_hz: Option<f64>,
    /// Largest speed of a joint, as a share of its limit [default: 0.5]
    #[arg(long, value_name = "PART", value_parser = number_in(0.01..=1.0, "a share from 0.01 to 1"))]
    speed: Option<f64>,
    /// Largest torque of a joint, as a share of its limit [default: 0.8]
    #[arg(long, value_name = "PART", value_parser = number_in(0.01..=1.0, "a share from 0.01 to 1"))]
    torque: Option<f64>,
    /// Height above which the arm stays, m in the base frame, or `none` [default: 0.05]
    #[arg(long, value_name = "M|none", allow_hyphen_values = true)]
    ground_m: Option<String>,
    /// Largest travel of a joint from its start position, rad or m [default: 1.2]
    #[arg(long, value_name = "RAD", value_parser = number_in(0.01..=6.3, "a travel from 0.01 to 6.3 rad"))]
    reach: Option<f64>,
    /// Slow the motion down by this factor, for a first try
    #[arg(long, value_name = "TIMES", default_value_t = 1.0, value_parser = number_in(1.0..=100.0, "a number from 1 to 100"))]
    slow_down: f64,
    /// Seed of the random search [default: 0]
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Print condition number, used shares of the limits and distances as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: RobotOnlySettings,
}

/// Format of the output file.
#[derive(Debug, Clone, Copy)]
enum Format {
    Csv,
    Yaml,
}

/// If a joint moves less, rad or m, its load and its friction are hardly determined.
const MIN_TRAVEL: f64 = 0.1;

/// Largest number of points of a file.
const MAX_POINTS: f64 = 1e6;

/// Names joints that hardly move.
fn note_nearly_still(robot: &Robot, found: &Excitation, output: &Output) {
    let way = |j: usize| {
        let at = found.points.iter().map(|point| point[0][j]);
        extremes(at).map_or(0.0, |[low, high]| high - low)
    };
    let names = robot.joint_names().enumerate().filter(|(j, _)| way(*j) < MIN_TRAVEL);
    let names: Vec<&str> = names.map(|(_, name)| name).collect();
    if !names.is_empty() {
        output.note(&format!(
            "joints that hardly move, since their limits, --reach, the ground or links close to each other leave no \
             room around this start: {}; choose another start (--start) to move them",
            names.join(", ")
        ));
    }
}

/// Finds the motion and writes it.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let settings: Settings = args.settings.load()?;
    let formats = [("csv", Format::Csv), ("yaml", Format::Yaml), ("yml", Format::Yaml)];
    let format = file_paths::format_of(&args.output, "file of a motion", &formats)?;
    let mut places = FilePaths::read(&args.settings, &settings, &[]);
    places.output("the motion (--output)", Some(&args.output))?;
    interrupt::listen();
    let arm = held_joints::without_fingers(robot::load(&settings.robot, output)?, output)?;
    // `identify` takes no --arm.
    let robot = logs::robot_flags(&RobotSettings { arm: None, ..settings.robot.clone() });
    let mut config = ExciteConfig { around: args.start.clone(), ..ExciteConfig::default() };
    config.duration_s = args.duration.unwrap_or(config.duration_s);
    config.rate_hz = args.rate_hz.unwrap_or(config.rate_hz);
    config.speed_share = args.speed.unwrap_or(config.speed_share);
    config.torque_share = args.torque.unwrap_or(config.torque_share);
    config.reach = args.reach.unwrap_or(config.reach);
    config.seed = args.seed.unwrap_or_default();
    config.ground_m = match args.ground_m.as_deref() {
        None => config.ground_m,
        Some("none") => None,
        Some(height) => Some(
            height.parse().ok().filter(|height: &f64| height.is_finite()).ok_or_else(|| {
                CliError::Usage(format!("--ground-m is `{height}`; wanted a height in m, or none"))
            })?,
        ),
    };
    // A slowed motion keeps its points per second, so it is computed with more of them.
    config.rate_hz *= args.slow_down;
    if config.rate_hz * config.duration_s > MAX_POINTS {
        return Err(CliError::Usage(format!(
            "--slow-down, --duration and --rate-hz together need more than {MAX_POINTS} points; make one of them \
             smaller"
        )));
    }
    let bar = output.begin(Some(config.tries as u64), "motions", "trying");
    let stop = || interrupt::pressed();
    let mut found = excite(&arm, &config, &stop, &|| bar.step()).map_err(|error| match stop() {
        true => CliError::Interrupted { kept: "; nothing was written".to_owned() },
        false => CliError::from(error.to_string()),
    })?;
    drop(bar);
    slow_down(&mut found, args.slow_down);
    let text = match format {
        Format::Csv => table(&arm.robot, &found),
        Format::Yaml => trajectory(&arm.robot, &found),
    };
    file_paths::write(&args.output, &text)?;
    note_nearly_still(&arm.robot, &found, output);
    if args.json {
        return output.json(&json!({
            "output": args.output, "condition": found.condition, "condition_of_first": found.first_condition,
            "speed_share": found.speed_share, "torque_share": found.torque_share, "lowest_m": found.lowest_m,
            "nearest_m": found.nearest_m, "points": found.points.len(),
        }));
    }
    let file = args.output.display();
    let next = match args.slow_down > 1.0 {
        true => {
            "play it with a hand on the emergency stop, then repeat without --slow-down".to_owned()
        }
        false => format!("play it, log it, and palpate identify LOG{robot}"),
    };
    output.result(&format!("{}\nNext: {next}\n", summary(&found, &file)))
}

/// Slows the motion down by the factor `times`, on the same path.
fn slow_down(found: &mut Excitation, times: f64) {
    found.times_s.iter_mut().for_each(|time_s| *time_s *= times);
    for [_, speeds, accelerations] in &mut found.points {
        speeds.iter_mut().for_each(|speed| *speed /= times);
        accelerations.iter_mut().for_each(|acceleration| *acceleration /= times * times);
    }
    found.speed_share /= times;
}

/// Describes the motion, as text.
fn summary(found: &Excitation, file: &dyn Display) -> String {
    let lowest = found.lowest_m.map_or(
        "The links have no surfaces: their height was not checked".to_owned(),
        |lowest_m| format!("Lowest point: z = {lowest_m:.2} m in the base frame"),
    );
    let nearest =
        found.nearest_m.map_or("self-collision was not checked".to_owned(), |nearest_m| {
            format!("smallest distance between links: {nearest_m:.2} m")
        });
    format!(
        "{} points over {:.0} s are in `{file}`.\nCondition number {:.0} (of the first motion within the limits: \
         {:.0}). The motion uses at most {:.0} % of the joints' speed limits and {:.0} % of their torque limits. \
         {lowest}; {nearest}.",
        found.points.len(),
        found.times_s.last().copied().unwrap_or_default(),
        found.condition,
        found.first_condition,
        100.0 * found.speed_share,
        100.0 * found.torque_share,
    )
}

/// A table with a row for each point: time, positions, speeds, accelerations.
fn table(robot: &Robot, found: &Excitation) -> String {
    let column =
        |what: &'static str| robot.joint_names().map(move |joint| format!("{joint}_{what}"));
    let head = ["time".to_owned()].into_iter();
    let head =
        head.chain(column("position")).chain(column("velocity")).chain(column("acceleration"));
    let rows = found.times_s.iter().zip(&found.points).map(|(time, point)| {
        let numbers = point.iter().flatten().map(|number| format!("{number:.9}"));
        [format!("{time:.6}")].into_iter().chain(numbers).collect()
    });
    csv::text(std::iter::once(head.collect()).chain(rows))
}

/// A `trajectory_msgs/JointTrajectory` as YAML.
fn trajectory(robot: &Robot, found: &Excitation) -> String {
    let list = |numbers: &[f64]| {
        let each: Vec<String> = numbers.iter().map(|number| format!("{number:.9}")).collect();
        format!("[{}]", each.join(", "))
    };
    let names: Vec<String> = robot.joint_names().map(|name| json!(name).to_string()).collect();
    let mut text = format!("joint_names: [{}]\npoints:\n", names.join(", "));
    for (time_s, [q, speed, acceleration]) in found.times_s.iter().zip(&found.points) {
        let (sec, nanosec) = (time_s.floor(), (time_s.fract() * 1e9).round().min(999_999_999.0));
        let _ = writeln!(
            text,
            "- positions: {}\n  velocities: {}\n  accelerations: {}\n  time_from_start: {{sec: {sec}, nanosec: {nanosec}}}",
            list(q),
            list(speed),
            list(acceleration)
        );
    }
    text
}
