//! Whether gravity points the other way than the URDF says, as where an arm hangs from a ceiling and its URDF stands upright.
//!
//! Gravity turned round looks like torques turned round: the sign that gravity tells is then wrong, and so is that of every
//! contact. From a free start and back to it, contacts and friction take work from the arm, and never give it any. What is
//! conservative, such as a payload that the robot does not know, adds nothing to that.

use palpate::{Gravity, MIN_TARE_FRAMES, Robot, Sample};

use super::super::finding::Finding;
use super::super::words::number;
use super::reading::Fit;
use crate::touches::RecordedTouch;

/// A touch comes back if no joint ends farther from where it began than this part of the largest way of a joint.
const BACK: f64 = 0.1;
/// The least work from start to end, as a part of the difference between the most and the least on the way.
const LEAST_PART: f64 = 0.1;
/// The same, J: a sensor's own hysteresis does a little in free motion.
const LEAST_J: f64 = 0.05;
/// Fewest touches that come back and do work.
const FEWEST: usize = 3;
/// The part of them that must give the arm work.
const LEAST_GIVING: f64 = 0.8;

/// Says so if touches that come back give the arm work.
pub(super) fn finding(
    touches: &[RecordedTouch],
    robot: &Robot,
    (fit, still_rad): (&Fit, f64),
) -> Option<Finding> {
    if fit.gravity == Gravity::Removed {
        return None;
    }
    let works: Vec<f64> =
        touches.iter().filter_map(|touch| work_j(touch, robot, fit, still_rad)).collect();
    let given: Vec<f64> = works.iter().copied().filter(|work| *work > 0.0).collect();
    if works.len() < FEWEST || (given.len() as f64) < LEAST_GIVING * works.len() as f64 {
        return None;
    }
    let what = format!(
        "the torques that are left over after gravity give the arm work, {} J in {} of {} touches that come back to their \
         start and do work, where contacts and friction only take it: gravity may point the other way than in the URDF, as \
         where the arm hangs from a ceiling; or somebody guided the arm by hand",
        number(given.iter().sum()),
        given.len(),
        works.len()
    );
    let remedy = "let the URDF say how the arm is mounted: the <origin rpy> of the joint between its root link, z up, \
                  and its base; else the sign of all contacts is wrong";
    Some(Finding::warning("mounting", what, remedy))
}

/// The work, J, that the external torque gives the arm from the start of a touch to its end; `None` if it does not come back,
/// does not stand still at both, or it is hardly any.
fn work_j(touch: &RecordedTouch, robot: &Robot, fit: &Fit, still_rad: f64) -> Option<f64> {
    let still = touch.still_frames(still_rad);
    let start = &touch.samples.first()?.q;
    let farthest = |way: Vec<f64>| way.iter().fold(0.0, |most: f64, way| most.max(way.abs()));
    let ways = touch.samples.iter().map(|sample| farthest(robot.difference(start, &sample.q)));
    let back = farthest(robot.difference(start, &touch.samples.last()?.q));
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
    let rests = |sample: &&Sample| farthest(robot.difference(end, &sample.q)) <= still_rad;
    let still_at_end = touch.samples.iter().rev().take_while(rests).count();
    if still_at_end < MIN_TARE_FRAMES as usize {
        return None;
    }
    // Sensors drift: what they show at rest goes over from the start to the end.
    let mean = |of: &[Vec<f64>]| -> Vec<f64> {
        (0..robot.n_joints())
            .map(|j| of.iter().map(|tau| tau[j]).sum::<f64>() / of.len() as f64)
            .collect()
    };
    let last = external.len();
    let tares = [mean(&external[..still]), mean(&external[last - still_at_end..])];
    let (mut work, mut most, mut least) = (0.0_f64, 0.0_f64, 0.0_f64);
    for (number, (pair, torques)) in touch.samples.windows(2).zip(external.windows(2)).enumerate() {
        let part = number as f64 / last as f64;
        let way = robot.difference(&pair[0].q, &pair[1].q);
        let mean = |j: usize| {
            let tare = tares[0][j] + part * (tares[1][j] - tares[0][j]);
            f64::midpoint(torques[0][j], torques[1][j]) - tare
        };
        work += way.iter().enumerate().map(|(j, way)| mean(j) * way).sum::<f64>();
        (most, least) = (most.max(work), least.min(work));
    }
    (work.abs() > LEAST_J.max(LEAST_PART * (most - least))).then_some(work)
}
