//! Delay of logged torques after the positions to which they belong.
//!
//! Gravity shows it: in a touch that begins at rest, the torque of gravity at the logged positions leaves the noise of
//! the start at some frame, and the logged torque must leave it no later. Contacts and friction can only make it
//! earlier. Without gravity in the torques, the delay cannot be found.

use palpate::{Gravity, MIN_TARE_FRAMES, Robot, Sample};
use palpate_learn::evaluation::MeanStd;

use super::super::finding::Finding;
use super::super::words::{counted, number};
use super::mean;
use super::reading::ConventionFits;
use super::sensors::is_frozen;
use crate::quantile::median;
use crate::touches::RecordedTouch;

/// A torque has left its noise once it is off by more than this many standard deviations for this many frames.
const LEFT: f64 = 6.0;
const LEFT_FRAMES: usize = 3;
/// How far off a torque is, on average, when noise lets it stay beyond `LEFT`, standard deviations.
const FAR: f64 = 7.0;
/// Least standard deviation, N·m, for noise of sensors and errors of the gravity model.
const MIN_NOISE: f64 = 0.02;
/// Smallest delay that is reported, frames; smaller ones come from how sensors are read.
const MIN_DELAY: f64 = 3.0;
/// Smallest delay that is reported, s; smaller ones come from filters of joint torques.
const MIN_DELAY_S: f64 = 0.02;
/// Fewest touches whose delay must be known.
const FEWEST: usize = 3;

/// A warning if the torques are delayed; `period_s` is the log's median time step.
pub(super) fn finding(
    touches: &[RecordedTouch],
    robot: &Robot,
    (fits, still_rad): (&ConventionFits, f64),
    period_s: Option<f64>,
) -> Option<Finding> {
    let fit = fits.accepted();
    if !fits.has_enough_gravity() || fit.gravity != Gravity::Included {
        return None;
    }
    let delays: Vec<[f64; 2]> =
        touches.iter().filter_map(|touch| delay(touch, robot, still_rad)).collect();
    let [frames, at_least] = [0, 1].map(|which| {
        median(&delays.iter().map(|delay| delay[which]).collect::<Vec<f64>>()).unwrap_or(0.0)
    });
    let delay_s = period_s.map(|period_s| period_s * frames);
    let is_none = at_least < MIN_DELAY || delay_s.is_some_and(|s| s < MIN_DELAY_S);
    if delays.len() < FEWEST || is_none {
        return None;
    }
    let long = delay_s.map_or(String::new(), |s| format!(", {} s", number(s)));
    let what = format!(
        "the torques come about {} later than the positions{long}: in {}, the arm starts to move, \
         and the change of gravity shows in the torques only after this time",
        counted(frames as usize, "frame"),
        counted(delays.len(), "touch")
    );
    let remedy = "the object looks softer where the arm pushes and harder where it retreats; log \
                  positions and torques of one message, or shift the torques by this delay";
    Some(Finding::warning("delay", what, remedy))
}

/// Delay of the torques of a touch, frames: an estimate, and a lower bound that allows for noise. `None` if the touch
/// does not show its delay.
fn delay(touch: &RecordedTouch, robot: &Robot, still_rad: f64) -> Option<[f64; 2]> {
    let still = touch.still_frames(still_rad);
    if still < MIN_TARE_FRAMES as usize {
        return None;
    }
    let start = &touch.samples[..still];
    let stds: Vec<f64> = (0..robot.n_joints())
        .map(|joint| {
            let torques = start.iter().map(|sample| sample.tau[joint]);
            MeanStd::of(torques).map_or(0.0, |torque| torque.std).max(MIN_NOISE)
        })
        .collect();
    let gravity = |sample: &Sample| {
        let poses = robot.forward(&sample.q).ok()?;
        Some(robot.gravity_torque(&poses).as_slice().to_vec())
    };
    let at_rest = gravity(&start[0])?;
    let mean_start = mean(start, |sample| &sample.tau);
    // A frozen sensor has its own finding.
    let alive: Vec<usize> =
        (0..robot.n_joints()).filter(|joint| !is_frozen(touch, *joint)).collect();
    let off = |torques: &[f64], rest: &[f64]| {
        let off = |&joint: &usize| (torques[joint] - rest[joint]).abs() / stds[joint];
        alive.iter().map(off).fold(0.0, f64::max)
    };
    // The frame at which the torque has been off by more than `far` for `LEFT_FRAMES` frames.
    let leaves = |off: &dyn Fn(&Sample) -> Option<f64>, far: f64| {
        let mut beyond = 0;
        touch.samples.iter().position(|sample| {
            beyond = if off(sample).is_some_and(|off| off > far) { beyond + 1 } else { 0 };
            beyond == LEFT_FRAMES
        })
    };
    let by_gravity = |sample: &Sample| Some(off(&gravity(sample)?, &at_rest));
    let by_sensor = |sample: &Sample| Some(off(&sample.tau, &mean_start));
    let [left, far] = [LEFT, FAR].map(|far| leaves(&by_gravity, far));
    let measured = leaves(&by_sensor, LEFT)? as f64;
    Some([measured - left? as f64, measured - far? as f64])
}
