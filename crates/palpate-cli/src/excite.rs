//! `palpate excite`: a motion for `palpate identify`.

use std::fmt::Display;
use std::path::PathBuf;

use palpate_learn::excite::{Excitation, ExciteConfig};
use palpate_work::excite::{self, DURATION_S, RATE_HZ, REACH, SHARE, SLOW_DOWN};
use palpate_work::robot;
use palpate_work::settings::sections::RobotSettings;
use serde_json::json;

use crate::args::number_in;
use crate::error::CliError;
use crate::file_paths::{self, FilePaths};
use crate::output::Output;
use crate::settings::{RobotOnlySettings, Settings};
use crate::{interrupt, logs};

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
    #[arg(long, value_name = "S", value_parser = number_in(DURATION_S, "a number of seconds from 5 to 600"))]
    duration: Option<f64>,
    /// Points per second [default: 100]
    #[arg(long, value_name = "HZ", value_parser = number_in(RATE_HZ, "a rate from 5 to 2000 Hz"))]
    rate_hz: Option<f64>,
    /// Largest speed of a joint, as a share of its limit [default: 0.5]
    #[arg(long, value_name = "PART", value_parser = number_in(SHARE, "a share from 0.01 to 1"))]
    speed: Option<f64>,
    /// Largest torque of a joint, as a share of its limit [default: 0.8]
    #[arg(long, value_name = "PART", value_parser = number_in(SHARE, "a share from 0.01 to 1"))]
    torque: Option<f64>,
    /// Height above which the arm stays, m in the base frame, or `none` [default: 0.05]
    #[arg(long, value_name = "M|none", allow_hyphen_values = true)]
    ground_m: Option<String>,
    /// Largest travel of a joint from its start position, rad or m [default: 1.2]
    #[arg(long, value_name = "RAD", value_parser = number_in(REACH, "a travel from 0.01 to 6.3 rad"))]
    reach: Option<f64>,
    /// Slow the motion down by this factor, for a first try
    #[arg(long, value_name = "TIMES", default_value_t = 1.0, value_parser = number_in(SLOW_DOWN, "a number from 1 to 100"))]
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

/// Finds the motion and writes it.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let settings: Settings = args.settings.load()?;
    let formats = [("csv", Format::Csv), ("yaml", Format::Yaml), ("yml", Format::Yaml)];
    let format = file_paths::format_of(&args.output, "file of a motion", &formats)?;
    let mut places = FilePaths::read(&args.settings, &settings, &[]);
    places.output("the motion (--output)", Some(&args.output))?;
    interrupt::listen();
    let arm = robot::load(&settings.robot, output)?;
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
    let (arm, found) = excite::run(arm, config, args.slow_down, output)?;
    let text = match format {
        Format::Csv => excite::table(&arm.robot, &found),
        Format::Yaml => excite::trajectory(&arm.robot, &found),
    };
    file_paths::write(&args.output, &text)?;
    if args.json {
        let mut json = excite::json(&found);
        json["output"] = json!(args.output);
        return output.json(&json);
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
