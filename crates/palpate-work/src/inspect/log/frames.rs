//! Findings that show in the frames alone, without the robot's model: repeated frames, the clock.

use palpate::Robot;
use palpate_io::log::{AngleUnit, ClockEvidence, OddClock};
use palpate_learn::identify::ReadTimes;
use serde::Serialize;

use super::super::finding::Finding;
use super::super::words::{counted, number, times};
use crate::quantile::{extremes, median, quantile};
use crate::touches::{RecordedTouch, Touches};

/// From this number of identical frames at the start on, the sensor has no noise, which another finding reports.
pub(super) const NOISELESS_START: usize = 5;
/// A time step longer than this multiple of the median is a gap.
const GAP: f64 = 3.0;

/// The clock of a log.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct ClockFacts {
    /// Median time step, s.
    pub period_s: f64,
    /// 90 % quantile of |step − median|, s.
    pub jitter_s: f64,
    /// Sum of the durations of all touches, s.
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

/// All time steps: touch, row at the end of the step, length in s.
fn steps(touches: &[RecordedTouch]) -> impl Iterator<Item = (&RecordedTouch, usize, f64)> {
    touches.iter().flat_map(|touch| {
        let pairs = touch.samples.windows(2).enumerate();
        pairs.filter_map(move |(row, pair)| {
            Some((touch, row + 1, pair[1].time_s? - pair[0].time_s?))
        })
    })
}

/// Everything that looks wrong.
pub(super) fn findings(touches: &[RecordedTouch]) -> Vec<Finding> {
    let mut findings = Vec::from_iter(duplicates(touches));
    findings.extend(copies(touches));
    if let Some(clock) = clock(touches) {
        findings.extend(time_unit(touches));
        findings.extend(gaps(touches, clock.period_s));
    }
    findings.extend(backwards(touches));
    findings
}

/// A row of a touch, in words.
fn place(touch: &RecordedTouch, row: usize) -> (&str, String) {
    (&touch.name, format!("{} row {row}", touch.name))
}

/// Frames that are equal to the one before, including sensor noise.
fn duplicates(touches: &[RecordedTouch]) -> Option<Finding> {
    let of_touch = |touch: &RecordedTouch| {
        let same = |row: &usize| {
            let [before, now] = [row - 1, *row].map(|row| &touch.samples[row]);
            now.q == before.q && now.tau == before.tau
        };
        let repeats: Vec<usize> = (1..touch.frames()).filter(same).collect();
        let start = repeats.iter().zip(1..).take_while(|(row, n)| **row == *n).count();
        let skip = if start + 1 >= NOISELESS_START { start } else { 0 };
        repeats[skip..].to_vec()
    };
    let of_touch = |touch| of_touch(touch).into_iter().map(move |row| place(touch, row));
    let places: Vec<_> = touches.iter().flat_map(of_touch).collect();
    let frames: usize = touches.iter().map(RecordedTouch::frames).sum();
    let what = |n, rows| {
        let repeats = counted(n, "frame");
        format!("{repeats} of {frames} are exact copies of the frame before: {rows} (from 0)")
    };
    let remedy = "the log was written faster than the robot reports, and every copy would count as \
                  a new measurement; record each report once, or remove the copies";
    Finding::at_places("duplicate_frames", &places, what, remedy)
}

/// Touches that are equal to an earlier one, including sensor noise.
fn copies(touches: &[RecordedTouch]) -> Option<Finding> {
    let moves = |touch: &RecordedTouch| touch.samples.array_windows().any(|[a, b]| a.q != b.q);
    let same = |a: &RecordedTouch, b: &RecordedTouch| {
        // From the end, since touches without noise may have the same start.
        let mut pairs = a.samples.iter().zip(&b.samples).rev();
        a.frames() == b.frames() && pairs.all(|(a, b)| a.q == b.q && a.tau == b.tau)
    };
    let named = |touch: &RecordedTouch, other: &RecordedTouch| match touch
        .log
        .file_stem()
        .filter(|_| touch.name == other.name)
    {
        Some(log) => format!("`{}/{}`", log.display(), touch.name),
        None => format!("`{}`", touch.name),
    };
    let numbered = touches.iter().enumerate().filter(|(_, touch)| moves(touch));
    let copies = numbered.filter_map(|(number, touch)| {
        let other = touches[..number].iter().find(|other| same(other, touch))?;
        Some((&*touch.name, format!("{} of {}", named(touch, other), named(other, touch))))
    });
    let what = |n, copies| match n {
        1 => format!("a touch is an exact copy of another: {copies}"),
        n => format!("{n} touches are exact copies of others: {copies}"),
    };
    let remedy =
        "leave them out: they count twice, and cross-validation predicts them from themselves";
    Finding::at_places("duplicate_touches", &copies.collect::<Vec<_>>(), what, remedy)
}

/// A clock that is probably not in the unit in which it was read.
fn time_unit(touches: &[RecordedTouch]) -> Option<Finding> {
    let mut evidence = ClockEvidence::default();
    for touch in touches {
        evidence.touch_starts();
        touch.samples.iter().for_each(|sample| evidence.add(sample, AngleUnit::Rad));
    }
    let OddClock { period_s, crawls, .. } = evidence.odd()?;
    let (is_short, period_s) = (period_s < 1e-3, number(period_s));
    let slowly = if crawls { ", in which the arm hardly moves" } else { "" };
    let question = match is_short {
        true => "are the times in a larger unit than the one in which they were read?",
        false => "are the times in milliseconds or nanoseconds?",
    };
    let what = format!("the median time step is {period_s} s{slowly}: {question}");
    let remedy = "give the unit (--time-unit), or save seconds: `identify`, `torque` and --arm compute speeds from the \
                  times; maps without --arm need no times, but sampling rate and gaps cannot be checked";
    Some(Finding::warning("time_unit", what, remedy))
}

/// The unit of the times of each log in which it was found from the data.
pub(super) fn found_time_units(log: &Touches) -> impl Iterator<Item = Finding> {
    log.found_time_units().map(|(path, unit)| {
        let what = format!(
            "times of `{}` were read as {unit}: if they were seconds, samples would be too far apart, or the arm \
             too slow",
            path.display()
        );
        let remedy = format!(
            "nothing needs to change; to do without this guess, save seconds or give --time-unit {unit}"
        );
        Finding::warning("time_unit", what, remedy).noted()
    })
}

/// Time steps that are far longer than usual.
fn gaps(touches: &[RecordedTouch], period_s: f64) -> Option<Finding> {
    let gaps = || steps(touches).filter(|(_, _, step_s)| *step_s > GAP * period_s);
    let longest_s = gaps().map(|(_, _, step_s)| step_s).fold(0.0, f64::max);
    let places: Vec<_> = gaps().map(|(touch, row, _)| place(touch, row)).collect();
    let what = |n, rows| {
        format!(
            "{} in time, the longest of {} s where {} s is usual: before {rows} (from 0)",
            counted(n, "gap"),
            number(longest_s),
            number(period_s)
        )
    };
    let remedy = "the motion in between is assumed to be straight; if the arm moved or touched \
                  something there, record again or cut the touch there";
    Finding::at_places("gaps", &places, what, remedy)
}

/// A clock that does not advance.
fn backwards(touches: &[RecordedTouch]) -> Option<Finding> {
    let back = steps(touches).filter(|(_, _, step_s)| *step_s <= 0.0);
    let places: Vec<_> = back.map(|(touch, row, _)| place(touch, row)).collect();
    let what = |n, rows| {
        format!("the clock stands still or runs backwards {}: at {rows} (from 0)", times(n))
    };
    let remedy = "rows are used in the order of the log, whatever their times; if rows are out of order or \
                  two recordings were joined, sort or separate them";
    Finding::at_places("clock", &places, what, remedy)
}

/// Time stamps that are clearly not the times at which the joints were read.
pub(super) fn stamps(touches: &[RecordedTouch], robot: &Robot) -> Option<Finding> {
    let off = touches.iter().map(|touch| {
        let ReadTimes { corrected, rms_s } = ReadTimes::of(robot, &[&touch.samples]);
        (touch, corrected, rms_s)
    });
    let places: Vec<_> = off
        .filter(|(_, corrected, _)| *corrected > 0)
        .map(|(touch, _, rms_s)| (&*touch.name, format!("{} by {:.1} ms", touch.name, 1e3 * rms_s)))
        .collect();
    let what = |n, touches| {
        format!(
            "in {}, time stamps differ from the times at which the joints were read (root mean square): \
             {touches}; a usual reason is a node that publishes joint states again at another rate",
            counted(n, "touch"),
        )
    };
    let remedy = "maps need no times; `identify`, `torque` and `map --arm` correct the time stamps of logs; \
                  `live` cannot, so let it listen to the topic of the robot's driver";
    Finding::at_places("stamps", &places, what, remedy).map(Finding::noted)
}
