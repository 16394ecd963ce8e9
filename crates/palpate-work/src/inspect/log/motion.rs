//! Positions and speeds beyond the robot's limits.

use palpate::unstable::Joint;
use palpate::{Robot, Sample};

use super::super::finding::Finding;
use super::super::words::{counted, number, times};
use crate::quantile::extremes;
use crate::touches::RecordedTouch;

/// Tolerance of joint limits, rad or m: sensors overshoot by as much.
pub(crate) const LIMIT_MARGIN: f64 = 0.01;
/// A speed above this multiple of the limit is a jump.
const JUMP: f64 = 1.5;
/// Smallest jump, rad or m.
const MIN_JUMP: f64 = 0.02;
/// Smallest jump if there is no clock or no speed limit, rad or m.
const JUMP_ANYWAY: f64 = 0.5;

/// Everything that looks wrong.
pub(super) fn findings(
    touches: &[RecordedTouch],
    robot: &Robot,
    period_s: Option<f64>,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    for joint in 0..robot.n_joints() {
        findings.extend(outside(touches, robot, joint));
    }
    findings.extend(jumps(touches, robot, period_s));
    findings
}

/// Positions beyond the limits of a joint.
fn outside(touches: &[RecordedTouch], robot: &Robot, joint: usize) -> Option<Finding> {
    let limits = &robot.joints()[joint];
    let [low, high] = limits.range?;
    let positions =
        || touches.iter().flat_map(|touch| &touch.samples).map(|sample| sample.q[joint]);
    let beyond = |&q: &f64| q < low - LIMIT_MARGIN || q > high + LIMIT_MARGIN;
    let frames = positions().filter(beyond).count();
    let [least, most] = extremes(positions())?;
    let [least, most, low, high] = [least, most, low, high].map(number);
    (frames > 0).then(|| {
        let what = format!(
            "joint `{}` goes from {least} to {most}, beyond its limits {low} .. {high}, in {}",
            limits.name,
            counted(frames, "frame")
        );
        let remedy = "check the robot (--robot), the order of the joints and the unit \
                      (--angle-unit)";
        Finding::warning("joint_limits", what, remedy).at(&[&limits.name])
    })
}

/// Motions from one frame to the next that are too fast for the robot.
fn jumps(touches: &[RecordedTouch], robot: &Robot, period_s: Option<f64>) -> Option<Finding> {
    let joints = robot.joints();
    let jump = |before: &Sample, now: &Sample| {
        let step_s = match (now.time_s, before.time_s) {
            (Some(now_s), Some(before_s)) if now_s > before_s => Some(now_s - before_s),
            _ => period_s,
        };
        let ways = robot.difference(&before.q, &now.q);
        let moves = joints.iter().zip(ways).map(|(joint, way)| (joint, way.abs()));
        let jumped = |(joint, way): &(&Joint, f64)| match (step_s, joint.velocity) {
            (Some(step_s), Some(limit)) => *way > (JUMP * limit * step_s).max(MIN_JUMP),
            _ => *way > JUMP_ANYWAY,
        };
        moves.filter(jumped).max_by(|a, b| a.1.total_cmp(&b.1))
    };
    let mut places: Vec<(&str, String)> = Vec::new();
    for touch in touches {
        for (row, pair) in (1..).zip(touch.samples.windows(2)) {
            if let Some((joint, way)) = jump(&pair[0], &pair[1]) {
                let way = number(way);
                let place = format!("{} row {row} (`{}` by {way})", touch.name, joint.name);
                places.push((&touch.name, place));
            }
        }
    }
    let what = |n, rows| {
        let often = times(n);
        format!(
            "the arm jumps, faster than its joints can move, {often}: {rows} (rows from 0, rad or m)"
        )
    };
    let remedy = "frames are missing, recordings were joined, or the unit is wrong; cut the touch \
                  there, since a jump through the object looks like a push";
    Finding::at_places("jumps", &places, what, remedy)
}
