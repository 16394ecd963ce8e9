//! A motion for identification, and the content of its files.

use std::fmt::Write;
use std::ops::RangeInclusive;
use std::sync::Arc;

use palpate::{Arm, Robot};
use palpate_learn::excite::{Excitation, ExciteConfig, excite};
use serde_json::{Value, json};

use crate::csv;
use crate::error::WorkError;
use crate::held_joints::without_fingers;
use crate::progress::Progress;
use crate::quantile::extremes;
use crate::torque::check_range;

/// Allowed range of durations, s.
pub const DURATION_S: RangeInclusive<f64> = 5.0..=600.0;
/// Allowed range of points per second.
pub const RATE_HZ: RangeInclusive<f64> = 5.0..=2000.0;
/// Allowed range of shares of the limits of speed and torque.
pub const SHARE: RangeInclusive<f64> = 0.01..=1.0;
/// Allowed range of travels from the start, rad or m.
pub const REACH: RangeInclusive<f64> = 0.01..=6.3;
/// Allowed range of factors by which a motion is slowed down.
pub const SLOW_DOWN: RangeInclusive<f64> = 1.0..=100.0;

/// If a joint moves less, rad or m, its load and its friction are hardly determined.
const MIN_TRAVEL: f64 = 0.1;

/// Largest number of points of a motion.
const MAX_POINTS: f64 = 1e6;

/// Finds a motion of the arm without the joints of a gripper, slowed down by the factor `slow_down` at the points per
/// second of `config`; also returns this arm. Notes joints that hardly move.
///
/// # Errors
///
/// If a number is out of its range, the start is not allowed, no motion around it keeps to the limits, or on being
/// stopped.
pub fn run(
    arm: Arc<Arm>,
    mut config: ExciteConfig,
    slow_down: f64,
    progress: &dyn Progress,
) -> Result<(Arc<Arm>, Excitation), WorkError> {
    check(&config, slow_down)?;
    let arm = without_fingers(arm, progress)?;
    // A slowed motion keeps its points per second, so it is computed with more of them.
    config.rate_hz *= slow_down;
    if config.rate_hz * config.duration_s > MAX_POINTS {
        return Err(WorkError::Usage(format!(
            "--slow-down, --duration and --rate-hz together need more than {MAX_POINTS} points; make one of them \
             smaller"
        )));
    }
    let bar = progress.begin(Some(config.tries as u64), "motions", "trying");
    let stop = || progress.stopped();
    let mut found = excite(&arm, &config, &stop, &|| bar.step()).map_err(|error| match stop() {
        true => WorkError::Interrupted { kept: "; nothing was written".to_owned() },
        false => WorkError::Usage(error.to_string()),
    })?;
    drop(bar);
    slow(&mut found, slow_down);
    note_nearly_still(&arm.robot, &found, progress);
    Ok((arm, found))
}

fn check(config: &ExciteConfig, slow_down: f64) -> Result<(), WorkError> {
    check_range("duration", config.duration_s, &DURATION_S)?;
    check_range("rate_hz", config.rate_hz, &RATE_HZ)?;
    check_range("speed", config.speed_share, &SHARE)?;
    check_range("torque", config.torque_share, &SHARE)?;
    check_range("reach", config.reach, &REACH)?;
    check_range("slow_down", slow_down, &SLOW_DOWN)?;
    match config.ground_m.filter(|height| !height.is_finite()) {
        Some(height) => {
            Err(WorkError::Usage(format!("ground_m is {height}; wanted a height in m, or none")))
        }
        None => Ok(()),
    }
}

/// Slows the motion down by the factor `times`, on the same path.
fn slow(found: &mut Excitation, times: f64) {
    found.times_s.iter_mut().for_each(|time_s| *time_s *= times);
    for [_, speeds, accelerations] in &mut found.points {
        speeds.iter_mut().for_each(|speed| *speed /= times);
        accelerations.iter_mut().for_each(|acceleration| *acceleration /= times * times);
    }
    found.speed_share /= times;
}

/// Names joints that hardly move.
fn note_nearly_still(robot: &Robot, found: &Excitation, progress: &dyn Progress) {
    let way = |j: usize| {
        let at = found.points.iter().map(|point| point[0][j]);
        extremes(at).map_or(0.0, |[low, high]| high - low)
    };
    let names = robot.joint_names().enumerate().filter(|(j, _)| way(*j) < MIN_TRAVEL);
    let names: Vec<&str> = names.map(|(_, name)| name).collect();
    if !names.is_empty() {
        progress.note(&format!(
            "joints that hardly move, since their limits, --reach, the ground or links close to each other leave no \
             room around this start: {}; choose another start (--start) to move them",
            names.join(", ")
        ));
    }
}

/// The figures of the motion as JSON.
pub fn json(found: &Excitation) -> Value {
    json!({
        "condition": found.condition, "condition_of_first": found.first_condition,
        "speed_share": found.speed_share, "torque_share": found.torque_share, "lowest_m": found.lowest_m,
        "nearest_m": found.nearest_m, "points": found.points.len(),
    })
}

/// A table with a row for each point, as CSV: time, positions, speeds, accelerations.
pub fn table(robot: &Robot, found: &Excitation) -> String {
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
pub fn trajectory(robot: &Robot, found: &Excitation) -> String {
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
