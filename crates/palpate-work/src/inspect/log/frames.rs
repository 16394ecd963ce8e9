//! What shows in the frames alone, without knowing the robot: repeated frames, the clock, sensors
//! that stand still.

use palpate::Sample;
use serde::Serialize;

use super::super::finding::Finding;
use super::super::words::{counted, listed, number, times};
use crate::quantile::{extremes, median, quantile};
use crate::touches::RecordedTouch;

/// So many identical frames at the start are a sensor without noise, told elsewhere.
pub(super) const NOISELESS_START: usize = 5;
/// A time step longer than so many medians is a gap.
const GAP: f64 = 3.0;
/// A median period beyond these is hardly in seconds.
const BELIEVABLE_PERIOD_S: [f64; 2] = [1e-5, 5.0];
/// A column must be this long before standing still means anything.
const FROZEN_FRAMES: usize = 10;

/// The clock of a log.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ClockFacts {
    /// Median time step, s.
    pub period_s: f64,
    /// How far nine steps of ten stay from it, s.
    pub jitter_s: f64,
    /// Sum of all touches, s.
    pub duration_s: f64,
}

/// The clock, if the log has one that advances.
pub(super) fn clock(touches: &[RecordedTouch]) -> Option<ClockFacts> {
    let steps: Vec<f64> =
        steps(touches).map(|(_, _, step_s)| step_s).filter(|&s| s > 0.0).collect();
    let period_s = median(&steps)?;
    let off: Vec<f64> = steps.iter().map(|step_s| (step_s - period_s).abs()).collect();
    let duration_s = (touches.iter())
        .filter_map(|touch| extremes(touch.times_s()))
        .map(|[first, last]| last - first)
        .sum();
    Some(ClockFacts { period_s, jitter_s: quantile(&off, 0.9)?, duration_s })
}

/// All time steps: touch, row that it leads to, length in s.
fn steps(touches: &[RecordedTouch]) -> impl Iterator<Item = (&RecordedTouch, usize, f64)> {
    touches.iter().flat_map(|touch| {
        let pairs = touch.samples.windows(2).enumerate();
        pairs.filter_map(move |(row, pair)| {
            Some((touch, row + 1, pair[1].time_s? - pair[0].time_s?))
        })
    })
}

/// Everything that looks wrong.
pub(super) fn findings(touches: &[RecordedTouch], joints: &[String]) -> Vec<Finding> {
    let mut findings: Vec<Finding> = [duplicates(touches)].into_iter().flatten().collect();
    findings.extend(clock(touches).iter().flat_map(|clock| timing(touches, clock)));
    findings.extend(backwards(touches));
    findings.extend(frozen(touches, joints));
    findings
}

/// Names of the touches in which things happened, each once.
fn touches_of<'a, T>(places: &[(&'a RecordedTouch, T)]) -> Vec<&'a str> {
    let mut names: Vec<&str> = places.iter().map(|(touch, _)| touch.name.as_str()).collect();
    names.dedup();
    names
}

/// `touch row …` for each place.
fn rows(places: &[(&RecordedTouch, usize)]) -> String {
    let named = places.iter().map(|(touch, row)| format!("{} row {row}", touch.name));
    listed(&named.collect::<Vec<_>>())
}

/// Frames that repeat the one before, sensor noise and all.
fn duplicates(touches: &[RecordedTouch]) -> Option<Finding> {
    let mut places: Vec<(&RecordedTouch, usize)> = Vec::new();
    for touch in touches {
        let same = |row: usize| {
            let [before, now] = [row - 1, row].map(|row| &touch.samples[row]);
            now.q == before.q && now.tau == before.tau
        };
        let repeats: Vec<usize> = (1..touch.frames()).filter(|&row| same(row)).collect();
        let start = repeats.iter().zip(1..).take_while(|(row, n)| **row == *n).count();
        let skip = if start + 1 >= NOISELESS_START { start } else { 0 };
        places.extend(repeats[skip..].iter().map(|&row| (touch, row)));
    }
    let frames: usize = touches.iter().map(RecordedTouch::frames).sum();
    (!places.is_empty()).then(|| {
        let what = format!(
            "{} of {frames} repeat the frame before to the last bit: {} (from 0)",
            counted(places.len(), "frame"),
            rows(&places)
        );
        let remedy = "the log was written faster than the robot reports, and every copy would \
                      count as new evidence; record each report once, or drop the copies";
        Finding::warning("duplicate_frames", what, remedy).in_touches(&touches_of(&places))
    })
}

/// Gaps, and a clock that is not in seconds.
fn timing(touches: &[RecordedTouch], clock: &ClockFacts) -> Vec<Finding> {
    let mut findings = Vec::new();
    let [least, most] = BELIEVABLE_PERIOD_S;
    if !(least..=most).contains(&clock.period_s) {
        let what = format!(
            "the median time step is {} s: milliseconds or nanoseconds?",
            number(clock.period_s)
        );
        let remedy = "times are not needed for mapping, but rates and gaps cannot be judged; save \
                      seconds";
        findings.push(Finding::warning("time_unit", what, remedy));
    }
    let is_gap = |&(_, _, step_s): &(&RecordedTouch, usize, f64)| step_s > GAP * clock.period_s;
    let gaps: Vec<(&RecordedTouch, usize, f64)> = steps(touches).filter(is_gap).collect();
    let longest = gaps.iter().map(|gap| gap.2).fold(0.0, f64::max);
    if !gaps.is_empty() {
        let places: Vec<(&RecordedTouch, usize)> = gaps.iter().map(|gap| (gap.0, gap.1)).collect();
        let what = format!(
            "{} in time, the longest of {} s where {} s is usual: before {} (from 0)",
            counted(gaps.len(), "gap"),
            number(longest),
            number(clock.period_s),
            rows(&places)
        );
        let remedy = "the motion in between is taken to be straight; if the arm moved or touched \
                      something there, record again or cut the touch there";
        findings.push(Finding::warning("gaps", what, remedy).in_touches(&touches_of(&places)));
    }
    findings
}

/// A clock that does not advance.
fn backwards(touches: &[RecordedTouch]) -> Option<Finding> {
    let places: Vec<(&RecordedTouch, usize)> = steps(touches)
        .filter(|(_, _, step_s)| *step_s <= 0.0)
        .map(|(touch, row, _)| (touch, row))
        .collect();
    (!places.is_empty()).then(|| {
        let what = format!(
            "the clock stands still or runs backwards {}: at {} (from 0)",
            times(places.len()),
            rows(&places)
        );
        let remedy = "the order of the rows is believed, not the clock; if rows are out of order \
                      or two recordings were joined, sort or part them";
        Finding::warning("clock", what, remedy).in_touches(&touches_of(&places))
    })
}

/// Torques that never change in a touch although the arm moves.
fn frozen(touches: &[RecordedTouch], joints: &[String]) -> Vec<Finding> {
    let constant = |touch: &RecordedTouch, value: &dyn Fn(&Sample) -> f64| {
        touch.samples.iter().all(|sample| value(sample) == value(&touch.samples[0]))
    };
    let alive = |touch: &&RecordedTouch| {
        let moves = |joint: usize| !constant(touch, &|sample| sample.q[joint]);
        touch.frames() >= FROZEN_FRAMES && (0..touch.n_joints()).any(moves)
    };
    let mut findings = Vec::new();
    for (joint, name) in joints.iter().enumerate() {
        let stuck: Vec<(&RecordedTouch, f64)> = (touches.iter().filter(alive))
            .filter(|touch| constant(touch, &|sample| sample.tau[joint]))
            .map(|touch| (touch, touch.samples[0].tau[joint]))
            .collect();
        if let Some((_, value)) = stuck.first() {
            let names = touches_of(&stuck);
            let what = format!(
                "the torque of joint `{name}` never changes from {} N·m in {} of {}: {}",
                number(*value),
                names.len(),
                counted(touches.len(), "touch"),
                listed(&names)
            );
            let remedy = "the sensor is dead or was not recorded, and its torque would count as \
                          measured; look at the driver, or leave these touches out";
            findings.push(
                Finding::warning("frozen_torque", what, remedy).in_touches(&names).at(&[name]),
            );
        }
    }
    findings
}
