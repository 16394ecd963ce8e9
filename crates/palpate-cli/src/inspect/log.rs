//! A log's facts for people.

use palpate::{Gravity, TorqueSign};
use palpate_io::log::{AngleUnit, Format};
use palpate_work::inspect::log::{LogFacts, Matching, Reading, TouchFacts};
use palpate_work::inspect::{counted, number};
use palpate_work::touched::TouchedFigures;

use super::field::lattice;
use super::page::{fact, table};
use crate::quantile::extremes;

/// What a log holds.
pub(super) fn text(log: &LogFacts) -> String {
    let format = match log.format {
        Format::NpyFolder => "npy folders",
        Format::Csv => "CSV",
        Format::Parquet => "Parquet",
        Format::Mcap => "bag of ROS 2, MCAP",
        Format::Rosbag2Sqlite => "bag of ROS 2, SQLite",
        _ => "another",
    };
    let mut text = fact("format", format);
    text += &fact("frames", &sizes(log));
    text += &fact("clock", &told_clock(log));
    text += &fact("joints", &told_joints(log));
    if let Some(reading) = &log.reading {
        text += &fact("torques", &told_reading(reading));
    }
    if let Some(touched) = &log.touched {
        text += &fact("lattice", &told_touched(touched));
        text += &fact("", &lattice(&log.lattice));
    }
    if log.touches.is_empty() {
        return text;
    }
    text += &table("Touches", &touch_rows(log));
    let by_joint = |of: fn(&TouchFacts) -> Option<Vec<f64>>| joint_rows(log, of);
    text += &table("Tare, N·m", &by_joint(|touch| touch.tare.clone()));
    text += &table("Noise at rest, N·m", &by_joint(|touch| touch.noise_std.clone()));
    text + &table(
        "Largest external torque, N·m",
        &by_joint(|touch| Some(touch.peak_by_joint.clone())),
    )
}

fn sizes(log: &LogFacts) -> String {
    let touches = match log.touches.len() {
        0 => String::new(),
        n => {
            let sizes = extremes(log.touches.iter().map(|touch| touch.frames as f64));
            let [least, most] = sizes.unwrap_or_default();
            let each =
                if least == most { format!("{least}") } else { format!("{least} to {most}") };
            format!(" in {} of {each}", counted(n, "touch"))
        }
    };
    format!("{}{touches}", log.frames)
}

fn told_clock(log: &LogFacts) -> String {
    match &log.clock {
        Some(clock) => format!(
            "{} s in all; {} Hz (a frame every {} ms, nine of ten within {} ms)",
            number(clock.duration_s),
            number(clock.period_s.recip()),
            number(1e3 * clock.period_s),
            number((1e6 * clock.jitter_s).round() / 1e3)
        ),
        None => "none: rate and gaps are unknown".to_owned(),
    }
}

fn told_joints(log: &LogFacts) -> String {
    let how = match log.matching {
        Matching::Unnamed => "the log names none; order of",
        Matching::InOrder => "by name, in the order of",
        Matching::Reordered => "by name, in another order than",
        Matching::Unmatched => "not those of",
    };
    let joints = format!("{}, {how} `{}`", log.joints.len(), log.robot);
    match log.matching {
        Matching::Unmatched => joints,
        _ => format!("{joints}: {}", log.joints.join(", ")),
    }
}

fn touch_rows(log: &LogFacts) -> Vec<Vec<String>> {
    let heads = ["touch", "frames", "s", "start", "peak N·m", "at", "moves", "of"];
    let mut rows = vec![heads.map(str::to_owned).to_vec()];
    for touch in &log.touches {
        let largest = |values: &[f64]| {
            let values = values.iter().copied().enumerate();
            values.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0))
        };
        let ways: Vec<f64> = touch.range.iter().map(|[low, high]| high - low).collect();
        let ((mover, way), (feeler, _)) = (largest(&ways), largest(&touch.peak_by_joint));
        rows.push(vec![
            touch.name.clone(),
            touch.frames.to_string(),
            touch.duration_s.map_or_else(|| "-".to_owned(), |s| format!("{s:.1}")),
            touch.start_frames.to_string(),
            format!("{:.2}", touch.peak_external),
            log.joints[feeler].clone(),
            format!("{way:.3}"),
            log.joints[mover].clone(),
        ]);
    }
    rows
}

/// A row a touch, a column a joint.
fn joint_rows(log: &LogFacts, of: fn(&TouchFacts) -> Option<Vec<f64>>) -> Vec<Vec<String>> {
    let heads = std::iter::once("touch".to_owned()).chain(log.joints.iter().cloned());
    let mut rows = vec![heads.collect::<Vec<_>>()];
    for touch in &log.touches {
        let cells = match of(touch) {
            Some(values) => values.iter().map(|value| format!("{value:.3}")).collect(),
            None => vec!["-".to_owned(); log.joints.len()],
        };
        rows.push(std::iter::once(touch.name.clone()).chain(cells).collect());
    }
    rows
}

fn told_touched(touched: &TouchedFigures) -> String {
    let TouchedFigures { frames, frames_in_contact, contacts_median, cells_touched } = touched;
    format!(
        "{frames_in_contact} of {frames} frames touch it, {contacts_median} points in the median, \
         {cells_touched} cells in all"
    )
}

fn told_reading(reading: &Reading) -> String {
    let fits = &reading.fits;
    let fit = fits.accepted();
    let sign = match fit.torque_sign {
        TorqueSign::Plus => "plus",
        TorqueSign::Minus => "minus",
    };
    let gravity = match fit.gravity {
        Gravity::Included => "included",
        Gravity::Removed => "removed",
    };
    let unit = match reading.angle_unit {
        AngleUnit::Rad => "",
        AngleUnit::Deg => "; angles in degrees",
    };
    let check = if !fits.tell() {
        "gravity at rest is too small to check that by".to_owned()
    } else {
        format!(
            "{} {:.2} times gravity's {} N·m, {} N·m left over",
            if fits.at_rest { "at rest" } else { "on average" },
            fit.slope,
            number(fits.gravity_torque),
            number(fit.left_over)
        )
    };
    format!("sign {sign}, gravity {gravity}{unit}: {check}")
}
