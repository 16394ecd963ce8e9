//! Whether the arm is mounted as its URDF says, or for example hangs from a ceiling while its URDF has it upright.
//!
//! Opposite gravity looks like the opposite sign of the torques. That sign is then chosen wrongly, and all contact
//! torques have it. Over a motion that returns to a start without contact, contacts and friction can only take energy
//! from the arm. So an external torque that does positive work there has the wrong sign. Conservative errors, such as
//! an unknown payload, do no work over such a motion.

use palpate::{Gravity, MIN_TARE_FRAMES, Robot, Sample};

use super::super::finding::Finding;
use super::super::words::number;
use super::reading::ConventionFit;
use crate::touches::RecordedTouch;

/// A touch returns to its start if every joint ends nearer to it than this part of the largest displacement of a joint.
const BACK: f64 = 0.1;
/// Least work over a touch, as a part of the range between its least and greatest value during the touch.
const MIN_PART: f64 = 0.1;
/// Least work over a touch, J: hysteresis of the sensors does a little work in free motion.
const MIN_J: f64 = 0.05;
/// Fewest touches that return and do work.
const FEWEST: usize = 3;
/// Least share of them in which the work must be positive.
const MIN_GIVING: f64 = 0.8;

/// A warning if the external torque does positive work in touches that return to their start.
pub(super) fn finding(
    touches: &[RecordedTouch],
    robot: &Robot,
    (fit, still_rad): (&ConventionFit, f64),
) -> Option<Finding> {
    if fit.gravity == Gravity::Removed {
        return None;
    }
    let works: Vec<f64> =
        touches.iter().filter_map(|touch| work_j(touch, robot, fit, still_rad)).collect();
    let given: Vec<f64> = works.iter().copied().filter(|work| *work > 0.0).collect();
    if works.len() < FEWEST || (given.len() as f64) < MIN_GIVING * works.len() as f64 {
        return None;
    }
    let what = format!(
        "the torques less gravity do positive work on the arm, {} J in {} of {} touches that return to their start, \
         but contacts and friction can only take energy: the arm may be mounted otherwise than in the URDF, for \
         example on a ceiling; or somebody guided it by hand",
        number(given.iter().sum()),
        given.len(),
        works.len()
    );
    let remedy = "describe in the URDF how the arm is mounted: by the <origin rpy> of the joint between its root \
                  link, z up, and its base; otherwise all contact torques have the wrong sign";
    Some(Finding::warning("mounting", what, remedy))
}

/// The work, J, that the external torque does on the arm in a touch; `None` if the arm does not return, does not stand
/// still at start and end, or the work is too small.
fn work_j(
    touch: &RecordedTouch,
    robot: &Robot,
    fit: &ConventionFit,
    still_rad: f64,
) -> Option<f64> {
    let still = touch.still_frames(still_rad);
    let start = &touch.samples.first()?.q;
    let largest = |way: Vec<f64>| way.iter().fold(0.0, |most: f64, way| most.max(way.abs()));
    let ways = touch.samples.iter().map(|sample| largest(robot.difference(start, &sample.q)));
    let back = largest(robot.difference(start, &touch.samples.last()?.q));
    if still < MIN_TARE_FRAMES as usize || back > BACK * ways.fold(0.0, f64::max) {
        return None;
    }
    let sign = super::sign(fit.torque_sign);
    let mut external = Vec::with_capacity(touch.samples.len());
    for sample in &touch.samples {
        let gravity = robot.gravity_torque(&robot.forward(&sample.q).ok()?);
        let joints = sample.tau.iter().zip(gravity.iter());
        external.push(joints.map(|(tau, gravity)| sign * tau - gravity).collect::<Vec<f64>>());
    }
    let end = &touch.samples.last()?.q;
    let rests = |sample: &&Sample| largest(robot.difference(end, &sample.q)) <= still_rad;
    let still_at_end = touch.samples.iter().rev().take_while(rests).count();
    if still_at_end < MIN_TARE_FRAMES as usize {
        return None;
    }
    // Sensors drift: the tare is interpolated between start and end.
    let mean = |of: &[Vec<f64>]| super::mean(of, |tau| tau);
    let last = external.len();
    let tares = [mean(&external[..still]), mean(&external[last - still_at_end..])];
    let (mut work, mut most, mut least) = (0.0_f64, 0.0_f64, 0.0_f64);
    for (number, (pair, torques)) in touch.samples.windows(2).zip(external.windows(2)).enumerate() {
        let part = number as f64 / last as f64;
        let way = robot.difference(&pair[0].q, &pair[1].q);
        let midpoint = |j: usize| {
            let tare = tares[0][j] + part * (tares[1][j] - tares[0][j]);
            f64::midpoint(torques[0][j], torques[1][j]) - tare
        };
        work += way.iter().enumerate().map(|(j, way)| midpoint(j) * way).sum::<f64>();
        (most, least) = (most.max(work), least.min(work));
    }
    (work.abs() > MIN_J.max(MIN_PART * (most - least))).then_some(work)
}
