//! What the robot's limits say of a motion: positions, speeds, torques beyond them.

use palpate::unstable::{Joint, JointKind};
use palpate::{Robot, Sample};

use super::super::finding::Finding;
use super::super::words::{counted, listed, number, times};
use crate::quantile::extremes;
use crate::touches::RecordedTouch;

/// Sensors overshoot a limit by as much, rad or m.
const LIMIT_MARGIN: f64 = 0.01;
/// A speed of so many times the limit is no motion but a jump.
const JUMP: f64 = 1.5;
/// A jump is at least this long, rad or m.
const LEAST_JUMP: f64 = 0.02;
/// Without clock or speed limit, a jump is as long as this, rad or m.
const JUMP_ANYWAY: f64 = 0.5;
/// At this part of the effort limit a sensor may be saturated.
const SATURATED: f64 = 0.99;

/// Everything that looks wrong.
pub(super) fn findings(
    touches: &[RecordedTouch],
    robot: &Robot,
    period_s: Option<f64>,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    for joint in 0..robot.n_joints() {
        findings.extend(outside(touches, robot, joint));
        findings.extend(saturated(touches, robot, joint));
    }
    findings.extend(jumps(touches, robot, period_s));
    findings
}

/// Positions that the joint cannot take.
fn outside(touches: &[RecordedTouch], robot: &Robot, joint: usize) -> Option<Finding> {
    let limits = &robot.joints()[joint];
    let [low, high] = limits.range?;
    let positions =
        || touches.iter().flat_map(|touch| &touch.samples).map(|sample| sample.q[joint]);
    let beyond = |&q: &f64| q < low - LIMIT_MARGIN || q > high + LIMIT_MARGIN;
    let frames = positions().filter(beyond).count();
    let [least, most] = extremes(positions())?;
    (frames > 0).then(|| {
        let what = format!(
            "joint `{}` goes from {} to {}, beyond its limits {} .. {}, in {}",
            limits.name,
            number(least),
            number(most),
            number(low),
            number(high),
            counted(frames, "frame")
        );
        let remedy = "check the robot (--robot), the order of the joints and the unit \
                      (--angle-unit)";
        Finding::warning("joint_limits", what, remedy).at(&[&limits.name])
    })
}

/// Torques as large as the joint has.
fn saturated(touches: &[RecordedTouch], robot: &Robot, joint: usize) -> Option<Finding> {
    let limits = &robot.joints()[joint];
    let effort = limits.effort?;
    let full = |sample: &&Sample| sample.tau[joint].abs() >= SATURATED * effort;
    let shown: Vec<(&str, usize)> = (touches.iter())
        .map(|touch| (touch.name.as_str(), touch.samples.iter().filter(full).count()))
        .filter(|(_, frames)| *frames > 0)
        .collect();
    let frames: usize = shown.iter().map(|(_, frames)| frames).sum();
    let names: Vec<&str> = shown.iter().map(|(name, _)| *name).collect();
    (frames > 0).then(|| {
        let what = format!(
            "the torque of joint `{}` reaches its limit of {} N·m in {}: {}",
            limits.name,
            number(effort),
            counted(frames, "frame"),
            listed(&names)
        );
        let remedy = "what goes beyond is cut off and makes the object look softer; push less, or \
                      leave these touches out";
        Finding::warning("saturation", what, remedy).in_touches(&names).at(&[&limits.name])
    })
}

/// Motions from one frame to the next that are too fast for the robot.
fn jumps(touches: &[RecordedTouch], robot: &Robot, period_s: Option<f64>) -> Option<Finding> {
    let mut found: Vec<(&str, String)> = Vec::new();
    for touch in touches {
        for row in 1..touch.frames() {
            let [before, now] = [row - 1, row].map(|row| &touch.samples[row]);
            let step_s = match (now.time_s, before.time_s) {
                (Some(now_s), Some(before_s)) if now_s > before_s => Some(now_s - before_s),
                _ => period_s,
            };
            let way = ways(robot, &before.q, &now.q);
            let jumped = |&(joint, way): &(usize, f64)| {
                let limit = robot.joints()[joint].velocity;
                match (step_s, limit) {
                    (Some(step_s), Some(limit)) => way > (JUMP * limit * step_s).max(LEAST_JUMP),
                    _ => way > JUMP_ANYWAY,
                }
            };
            let jumps = way.into_iter().enumerate().filter(jumped);
            if let Some((joint, way)) = jumps.max_by(|a, b| a.1.total_cmp(&b.1)) {
                let joint = &robot.joints()[joint].name;
                let place = format!("{} row {row} (`{joint}` by {})", touch.name, number(way));
                found.push((&touch.name, place));
            }
        }
    }
    let mut names: Vec<&str> = found.iter().map(|(name, _)| *name).collect();
    names.dedup();
    let places: Vec<&str> = found.iter().map(|(_, place)| place.as_str()).collect();
    (!found.is_empty()).then(|| {
        let what = format!(
            "the arm jumps, faster than its joints can move, {}: {} (rows from 0, rad or m)",
            times(found.len()),
            listed(&places)
        );
        let remedy = "frames are missing, recordings were joined, or the unit is wrong; cut the \
                      touch there, since a jump through the object looks like a push";
        Finding::warning("jumps", what, remedy).in_touches(&names)
    })
}

/// How far each joint moves, the shorter way round where it may turn for ever.
fn ways(robot: &Robot, from: &[f64], to: &[f64]) -> Vec<f64> {
    let way = |((joint, a), b): ((&Joint, &f64), &f64)| {
        let mut way = b - a;
        if joint.kind == JointKind::Continuous {
            way -= std::f64::consts::TAU * (way / std::f64::consts::TAU).round();
        }
        way.abs()
    };
    robot.joints().iter().zip(from).zip(to).map(way).collect()
}
