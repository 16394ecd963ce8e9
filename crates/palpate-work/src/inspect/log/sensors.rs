//! Torques that cannot be measurements: constant while the arm moves, or cut off at a value.

use std::collections::HashMap;

use palpate::{Robot, Sample};

use super::super::finding::Finding;
use super::super::words::{counted, listed, number};
use super::farthest;
use crate::quantile::{extremes, median, quantile};
use crate::touches::RecordedTouch;

/// Fewest frames of a touch in which a constant torque counts as frozen.
const FROZEN_FRAMES: usize = 10;
/// A torque was stuck if it was constant for at least this many frames, and for this multiple of
/// the 90 % quantile of its constant runs (its sensor may be slower than the log),
const STUCK_FRAMES: usize = 20;
const STUCK_TIMES: f64 = 10.0;
/// and if a joint moved by more than this meanwhile, rad or m,
const STUCK_MOVES: f64 = 0.01;
/// and if its next step, if there is one, was larger than this multiple of the median step: after a
/// constant run, a coarse sensor makes a usual step.
const STUCK_JUMP: f64 = 3.0;
/// A torque is cut off if it stays at its largest or smallest value, to the last bit, for at least
/// this many steps in which the arm moves,
const CUT_STEPS: usize = 5;
/// and for more than this multiple of such steps at any other value, of which a coarse sensor has
/// some.
const CUT_TIMES: usize = 4;
/// Share of the effort limit from which on a sensor may be saturated.
const SATURATED: f64 = 0.99;

/// Torques above this multiple of the effort limit are not cut off by the sensor: if there are many, they are in another
/// unit.
const BEYOND: f64 = 5.0;
/// Share of the samples above which torques beyond that multiple are many.
const OFTEN_BEYOND: f64 = 0.1;

/// Everything that looks wrong; without a robot, joints have no effort limits.
pub(super) fn findings(
    touches: &[RecordedTouch],
    joints: &[String],
    robot: Option<&Robot>,
) -> Vec<Finding> {
    // A touch of another robot has its own finding.
    let touches: Vec<&RecordedTouch> = touches
        .iter()
        .filter(|touch| touch.frames() > 0 && touch.n_joints() == joints.len())
        .collect();
    let mut findings = Vec::new();
    let all_frozen = all_frozen(&touches, joints);
    for (joint, name) in joints.iter().enumerate() {
        let effort = robot.and_then(|robot| robot.joints()[joint].effort);
        let saturated = effort.and_then(|effort| saturated(&touches, (joint, name), effort));
        if saturated.is_none() {
            findings.extend(cut_off(&touches, (joint, name)));
        }
        findings.extend(saturated);
        if all_frozen.is_none() {
            findings.extend(frozen(&touches, (joint, name)));
        }
        findings.extend(stuck(&touches, (joint, name)));
    }
    findings.extend(all_frozen);
    findings
}

/// One finding in place of one for each joint, if no torque changes in any touch.
fn all_frozen(touches: &[&RecordedTouch], joints: &[String]) -> Option<Finding> {
    let all = |touch: &&RecordedTouch| (0..joints.len()).all(|joint| is_frozen(touch, joint));
    (!touches.is_empty() && touches.iter().all(all)).then(|| {
        let names: Vec<&str> = joints.iter().map(String::as_str).collect();
        let what = "the torque of no joint ever changes";
        let remedy = "the torques were not recorded, or the robot does not report them; check the driver and the \
                      topic or columns of the torques";
        Finding::warning("frozen_torque", what, remedy).at(&names)
    })
}

/// Torques that never change in a touch although the arm moves.
fn frozen(touches: &[&RecordedTouch], (joint, name): (usize, &str)) -> Option<Finding> {
    let frozen: Vec<&RecordedTouch> =
        touches.iter().copied().filter(|touch| is_frozen(touch, joint)).collect();
    let mut names: Vec<&str> = frozen.iter().map(|touch| touch.name.as_str()).collect();
    names.dedup();
    let what = format!(
        "the torque of joint `{name}` never changes from {} N·m in {} of {}: {}",
        number(frozen.first()?.samples[0].tau[joint]),
        names.len(),
        counted(touches.len(), "touch"),
        listed(&names)
    );
    let remedy = "the sensor is dead or was not recorded, and its torque would count as measured; \
                  check the driver, or leave these touches out";
    Some(Finding::warning("frozen_torque", what, remedy).in_touches(&names).at(&[name]))
}

/// Whether a torque never changes in a touch in which the arm moves.
pub(super) fn is_frozen(touch: &RecordedTouch, joint: usize) -> bool {
    let constant = |value: &dyn Fn(&Sample) -> f64| {
        touch.samples.iter().all(|sample| value(sample) == value(&touch.samples[0]))
    };
    touch.frames() >= FROZEN_FRAMES
        && constant(&|sample| sample.tau[joint])
        && !(0..touch.n_joints()).all(|joint| constant(&|sample| sample.q[joint]))
}

/// Torques that are constant for a part of a touch although the arm moves.
fn stuck(touches: &[&RecordedTouch], (joint, name): (usize, &str)) -> Option<Finding> {
    let mut places: Vec<(&str, String)> = Vec::new();
    for touch in touches.iter().filter(|touch| !is_frozen(touch, joint)) {
        let torque = |sample: &Sample| sample.tau[joint];
        let runs: Vec<&[Sample]> = touch.samples.chunk_by(|a, b| torque(a) == torque(b)).collect();
        let lengths: Vec<f64> = runs.iter().map(|run| run.len() as f64).collect();
        let usual = quantile(&lengths, 0.9).unwrap_or(0.0);
        let least = (STUCK_TIMES * usual).max(STUCK_FRAMES as f64);
        let step = |pair: &[&[Sample]]| (torque(&pair[1][0]) - torque(&pair[0][0])).abs();
        let usual_step = median(&runs.windows(2).map(step).collect::<Vec<_>>()).unwrap_or(0.0);
        let mut row = 0;
        for (number_of, run) in runs.iter().enumerate() {
            let moves = run.iter().any(|sample| farthest(&sample.q, &run[0].q) > STUCK_MOVES);
            let jumps = runs.get(number_of..number_of + 2).map(step);
            let jumps = jumps.is_none_or(|jump| jump > STUCK_JUMP * usual_step);
            if run.len() as f64 >= least && moves && jumps {
                let (to, value) = (row + run.len() - 1, number(torque(&run[0])));
                let place = format!("{} rows {row} to {to} at {value} N·m", touch.name);
                places.push((&touch.name, place));
            }
            row += run.len();
        }
    }
    let what = |n, rows| {
        let stretches = counted(n, "stretch");
        format!(
            "the torque of joint `{name}` does not change while the arm moves, in {stretches}: \
                 {rows} (from 0)"
        )
    };
    let remedy = "the sensor hung or the driver repeated its last value, and all copies would count as \
                  measured; check the driver, or leave these touches out";
    Some(Finding::at_places("stuck_torque", &places, what, remedy)?.at(&[name]))
}

/// Torques that reach the effort limit of the joint.
fn saturated(
    touches: &[&RecordedTouch],
    (joint, name): (usize, &str),
    effort: f64,
) -> Option<Finding> {
    let samples = touches.iter().flat_map(|touch| &touch.samples);
    let torques: Vec<f64> = samples.map(|sample| sample.tau[joint].abs()).collect();
    let beyond = torques.iter().filter(|torque| **torque > BEYOND * effort).count();
    let largest = torques.iter().copied().fold(0.0, f64::max);
    if beyond as f64 > OFTEN_BEYOND * torques.len() as f64 {
        let (largest, effort) = (number(largest), number(effort));
        let what = format!(
            "the torque of joint `{name}` is far beyond its limit of {effort} N·m in {} of {}, up to {largest} N·m",
            beyond,
            counted(torques.len(), "frame")
        );
        let remedy = "check the unit of this column (wanted N·m; a thousand times too large are mN·m), and the effort \
                      limit in the URDF";
        return Some(Finding::warning("torque_unit", what, remedy).at(&[name]));
    }
    let is_full = |sample: &Sample| sample.tau[joint].abs() >= SATURATED * effort;
    let what = format!("reaches its limit of {} N·m", number(effort));
    capped(touches, name, ("saturation", &what), is_full)
}

/// Torques that are cut off at a value, below the effort limit of the joint.
fn cut_off(touches: &[&RecordedTouch], (joint, name): (usize, &str)) -> Option<Finding> {
    let torque = |sample: &Sample| sample.tau[joint];
    let samples = || touches.iter().flat_map(|touch| &touch.samples);
    // Steps in which the arm moves and the torque stays, by its value.
    let mut stays: HashMap<u64, usize> = HashMap::new();
    for pair in touches.iter().flat_map(|touch| touch.samples.windows(2)) {
        if torque(&pair[0]) == torque(&pair[1]) && pair[0].q != pair[1].q {
            *stays.entry(torque(&pair[0]).to_bits()).or_default() += 1;
        }
    }
    let ends = extremes(samples().map(torque)).filter(|[low, high]| low < high)?;
    let at = |value: f64| stays.get(&value.to_bits()).copied().unwrap_or(0);
    let others = stays.iter().filter(|(value, _)| !ends.map(f64::to_bits).contains(value));
    let usual = others.map(|(_, steps)| *steps).max().unwrap_or(0);
    // Without noise, as in a simulation, a torque stays at that of the start until the arm touches.
    let starts = |value: f64| touches.iter().any(|touch| torque(&touch.samples[0]) == value);
    let is_cut = |value: &f64| {
        let (stays, rests) = (at(*value), *value == 0.0 || starts(*value));
        !rests && stays >= CUT_STEPS && stays > CUT_TIMES * usual
    };
    let cut: Vec<f64> = ends.into_iter().filter(is_cut).collect();
    let values: Vec<String> = cut.iter().map(|value| number(*value)).collect();
    let what = format!("is cut off at {} N·m", values.join(" and "));
    let is_there = |sample: &Sample| cut.contains(&torque(sample));
    capped(touches, name, ("clipped_torque", &what), is_there)
}

/// A warning about frames with capped torques; `None` if there are none.
fn capped(
    touches: &[&RecordedTouch],
    name: &str,
    (code, what): (&'static str, &str),
    is_capped: impl Fn(&Sample) -> bool,
) -> Option<Finding> {
    let capped = |touch: &RecordedTouch| touch.samples.iter().filter(|&one| is_capped(one)).count();
    let shown = touches.iter().filter(|touch| capped(touch) > 0);
    let names: Vec<&str> = shown.map(|touch| touch.name.as_str()).collect();
    (!names.is_empty()).then(|| {
        let frames = counted(touches.iter().map(|touch| capped(touch)).sum(), "frame");
        let names_listed = listed(&names);
        let what = format!("the torque of joint `{name}` {what}, in {frames}: {names_listed}");
        let remedy = "larger torques are cut off, so the object looks softer than it is; push less, or \
                      leave these touches out";
        Finding::warning(code, what, remedy).in_touches(&names).at(&[name])
    })
}
