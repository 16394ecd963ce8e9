//! The facts of a log, as text.

use palpate_io::log::{AngleUnit, CsvColumns, LogFormat};
use palpate_work::contact_counts::ContactFigures;
use palpate_work::inspect::log::{LogFacts, LogInterpretation, Matching, TouchFacts};
use palpate_work::inspect::{counted, number, word};

use super::field::lattice;
use super::page::{fact, table};
use crate::output::figure;
use palpate_work::quantile::extremes;

/// The facts of a log.
pub(super) fn text(log: &LogFacts) -> String {
    let format = match log.format {
        LogFormat::NpyFolder => "npy folders",
        LogFormat::Csv => "CSV",
        LogFormat::Parquet => "Parquet",
        LogFormat::Mcap => "bag of ROS 2, MCAP",
        LogFormat::Rosbag2Sqlite => "bag of ROS 2, SQLite",
        _ => "another",
    };
    let mut text = fact("format", format);
    if let Some(columns) = &log.columns {
        text += &fact("columns", &columns_text(columns));
    }
    text += &fact("frames", &sizes(log));
    text += &fact("clock", &clock_text(log));
    text += &fact("joints", &joints_text(log));
    if let Some(reading) = &log.reading {
        text += &fact("torques", &reading_text(reading));
    }
    if let Some(touched) = &log.touched {
        text += &fact("lattice", &touched_text(touched));
        text += &fact("", &lattice(&log.lattice));
    }
    if log.touches.is_empty() {
        return text;
    }
    let columns = ["touch", "frames", "s", "start", "peak N·m", "at joint", "travel", "of joint"];
    let rows = log.touches.iter().map(|touch| touch_row(touch, &log.joints));
    text += &table("Touches", &columns, rows);
    let by_joint = |heading: &str, of: fn(&TouchFacts) -> Option<&Vec<f64>>| {
        let joints = log.joints.iter().map(String::as_str);
        let columns: Vec<&str> = std::iter::once("touch").chain(joints).collect();
        let rows = log.touches.iter().map(|touch| {
            let mut row = vec![touch.name.clone()];
            match of(touch) {
                Some(values) => row.extend(values.iter().map(|value| format!("{value:.3}"))),
                None => row.resize(columns.len(), "-".to_owned()),
            }
            row
        });
        table(heading, &columns, rows)
    };
    text += &by_joint("Tare, N·m", |touch| touch.tare.as_ref());
    text += &by_joint("Noise at rest, N·m", |touch| touch.noise_std.as_ref());
    text + &by_joint("Largest external torque, N·m", |touch| Some(&touch.peak_by_joint))
}

/// The columns that are read: the first and the last of each kind.
fn columns_text(columns: &CsvColumns) -> String {
    let ends = |names: &[String]| match names {
        [first, .., last] => format!("{first} … {last}"),
        names => names.concat(),
    };
    let mut text = format!("{}; {}", ends(&columns.q), ends(&columns.tau));
    for (what, name) in [("time", &columns.time), ("touch", &columns.touch)] {
        if let Some(name) = name {
            text += &format!("; {what}: {name}");
        }
    }
    text
}

fn sizes(log: &LogFacts) -> String {
    let sizes = extremes(log.touches.iter().map(|touch| touch.frames as f64));
    let Some([least, most]) = sizes else { return log.frames.to_string() };
    let each = if least == most { format!("{least}") } else { format!("{least} to {most}") };
    format!("{} in {} of {each}", log.frames, counted(log.touches.len(), "touch"))
}

fn clock_text(log: &LogFacts) -> String {
    let Some(clock) = &log.clock else {
        return "none that advances: rate and gaps are unknown".to_owned();
    };
    format!(
        "{} s in all; {} Hz (a frame every {} ms, 90 % of them within ± {} ms)",
        number(clock.duration_s),
        number(clock.period_s.recip()),
        number(1e3 * clock.period_s),
        number((1e6 * clock.jitter_s).round() / 1e3)
    )
}

fn joints_text(log: &LogFacts) -> String {
    let how = match log.matching {
        Matching::Unnamed => "without names in the log, in the order of",
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

fn touch_row(touch: &TouchFacts, joints: &[String]) -> Vec<String> {
    let largest = |values: &[f64]| {
        let values = values.iter().copied().enumerate();
        values.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0))
    };
    let ways: Vec<f64> = touch.range.iter().map(|[low, high]| high - low).collect();
    let ((mover, way), (feeler, _)) = (largest(&ways), largest(&touch.peak_by_joint));
    vec![
        touch.name.clone(),
        touch.frames.to_string(),
        figure(touch.duration_s, 1),
        touch.start_frames.to_string(),
        format!("{:.2}", touch.peak_external),
        joints[feeler].clone(),
        format!("{way:.3}"),
        joints[mover].clone(),
    ]
}

fn touched_text(touched: &ContactFigures) -> String {
    let ContactFigures { frames, frames_in_contact, contacts_median, cells_touched } = touched;
    format!(
        "{frames_in_contact} of {frames} frames touch it, {contacts_median} points in the median, \
         {cells_touched} cells in all"
    )
}

fn reading_text(reading: &LogInterpretation) -> String {
    let fits = &reading.fits;
    let fit = fits.accepted();
    let unit = match reading.angle_unit {
        AngleUnit::Rad => "",
        AngleUnit::Deg => "; angles in degrees",
    };
    let check = if fits.has_enough_gravity() {
        format!(
            "{} {:.2} times the {} N·m of gravity, residual {} N·m",
            if fits.at_rest { "at rest" } else { "on average" },
            fit.slope,
            number(fits.gravity_torque),
            number(fit.residual)
        )
    } else {
        "gravity at rest is too small to check this".to_owned()
    };
    let (sign, gravity) = (word(fit.torque_sign), word(fit.gravity));
    format!("sign {sign}, gravity {gravity}{unit}: {check}")
}
