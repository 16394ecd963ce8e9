//! `palpate torque`: the external torque of every joint with its standard deviation, and contact detection.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use palpate::{Arm, Differentiation, TorqueModel};
use palpate_io::torques::{TorqueFormat, TorqueRow, WrenchRow, write};
use palpate_work::arm_file;
use palpate_work::quantile::median;
use palpate_work::torque::{
    BANDWIDTH_HZ, ContactInterval, FALSE_ALARMS_PER_HOUR, ThresholdSource, TorqueFrame,
    TorqueSettings, TouchTorques, contacts, judge_threshold, threshold, torques, wrench_link,
};
use palpate_work::touches::Touches;
use serde_json::json;

use crate::args::number_in;
use crate::error::CliError;
use crate::file_paths::{self, FilePaths};
use crate::output::{Output, table};
use crate::settings::{RobotLogAndTouchSettings, Settings};
use crate::{interrupt, logs};

const NOTES: &str = "Examples:
  palpate torque recordings/ --robot robot.urdf --arm arm.toml -o torques.csv
  palpate torque push.mcap --robot fr3.urdf --arm arm.toml --free free.mcap --false-alarms 0.1 -o torques.mcap
  palpate torque push.mcap --robot fr3.urdf --arm arm.toml --wrench-link fr3_hand_tcp -o torques.parquet

Without --arm (a file of `palpate identify`), the masses are those of the URDF, friction and \
sensor bias are not known and remain in the torques, and the standard deviation is a guess from \
the effort limits. --tare-frames N subtracts the mean of the first N samples of each touch; by \
default no tare is subtracted.

A contact is reported where the torque of any joint, divided by its standard deviation, exceeds a \
threshold. Contact-free motion exceeds this threshold --false-alarms times per hour; it is \
determined from the logs of --free, or from the motion that was held out in identification.";

/// Default rate of accepted false alarms, per hour.
const USUAL_FALSE_ALARMS: f64 = 1.0;
/// Largest number of contacts that are printed as text.
const SHOWN_CONTACTS: usize = 40;

/// Flags of `palpate torque`.
#[derive(Debug, clap::Args)]
#[command(after_long_help = NOTES)]
pub(crate) struct Args {
    /// Logs
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Output file of the torques
    #[arg(long, short, value_name = "FILE.csv|.parquet|.mcap")]
    output: Option<PathBuf>,
    /// Logs of contact-free motion, from which the contact threshold is determined
    #[arg(long, value_name = "LOG")]
    free: Vec<PathBuf>,
    /// Accepted false alarms per hour [default: 1]
    #[arg(long, value_name = "PER_HOUR", value_parser = number_in(FALSE_ALARMS_PER_HOUR, "a number of alarms an hour above 0, 3600 at most"))]
    false_alarms: Option<f64>,
    /// Cutoff frequency of a first-order low-pass filter for the torques, Hz [default: no filter]
    #[arg(long, value_name = "HZ", value_parser = number_in(BANDWIDTH_HZ, "a frequency from 0.001 to 100000 Hz"))]
    bandwidth_hz: Option<f64>,
    /// Use only past samples at each sample, as `palpate live` does
    #[arg(long)]
    causal: bool,
    /// Also write the force and moment at the origin of this link that explain the torques best, along the axes of the
    /// base (.csv, .parquet) or of the link (.mcap)
    #[arg(long, value_name = "LINK")]
    wrench_link: Option<String>,
    /// Print contacts and noise as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: RobotLogAndTouchSettings,
}

/// Computes the external torques and prints what was found.
pub(crate) fn run(args: &Args, output: &Output) -> Result<(), CliError> {
    let mut settings = args.settings.load()?;
    let mut places = FilePaths::read(&args.settings, &settings, &args.logs);
    args.free.iter().for_each(|log| places.log(log));
    places.output("the torques (--output)", args.output.as_deref())?;
    let format = args.output.as_deref().map(format_of).transpose()?;
    if args.wrench_link.is_some() && format.is_none() {
        return Err(CliError::Usage(
            "the wrench of --wrench-link is written to a file: give --output".to_owned(),
        ));
    }
    interrupt::listen();
    let differentiation =
        if args.causal { Differentiation::Causal } else { Differentiation::Centred };
    let (touches, arm, model) = open(&args.logs, &mut settings, differentiation, output)?;
    let wrench_link =
        args.wrench_link.as_ref().map(|name| wrench_link(&arm.robot, name)).transpose()?;
    let tare_frames = settings.touch.first_frames();
    let how = TorqueSettings { bandwidth_hz: args.bandwidth_hz, tare_frames, wrench_link };
    let found = torques(&arm, &touches.read_for(&arm, &settings, output)?, &how, output)?;
    let free = if args.free.is_empty() {
        None
    } else {
        let mut settings = args.settings.load()?;
        let (touches, arm, _) = open(&args.free, &mut settings, differentiation, output)?;
        Some(torques(&arm, &touches.read_for(&arm, &settings, output)?, &how, output)?)
    };
    let per_hour = args.false_alarms.unwrap_or(USUAL_FALSE_ALARMS);
    let (threshold, from) = threshold(&model, free.as_deref(), per_hour)?;
    let joints: Vec<String> = arm.robot.joint_names().map(str::to_owned).collect();
    judge_threshold(&found, &joints, (threshold, from), &how, output);
    let contacts = contacts(&found, threshold);

    if let (Some(path), Some(format)) = (&args.output, format) {
        let link = args.wrench_link.as_deref().unwrap_or_default();
        write(path, format, &joints, &rows(&found, threshold, link)).map_err(CliError::file)?;
    }
    let is_identified = settings.robot.arm.is_some();
    print(args, (&found, &contacts, &joints), (threshold, from, is_identified), output)
}

/// Prints the torques of each touch and the contacts, as text or JSON.
fn print(
    args: &Args,
    (found, contacts, joints): (&[TouchTorques], &[ContactInterval], &[String]),
    (threshold, from, is_identified): (f64, ThresholdSource, bool),
    output: &Output,
) -> Result<(), CliError> {
    let per_hour = args.false_alarms.unwrap_or(USUAL_FALSE_ALARMS);
    if args.json {
        let each = |of: fn(&TouchTorques) -> Vec<f64>| found.iter().map(of).collect::<Vec<_>>();
        return output.json(&json!({
            "threshold": threshold, "threshold_from": from, "false_alarms_per_hour": per_hour,
            "contacts": contacts, "joints": joints,
            "touches": found.iter().map(|touch| &touch.name).collect::<Vec<_>>(),
            "rms_n_m": each(rms_torque), "std_n_m": each(median_std),
        }));
    }
    let source = threshold_source(from, per_hour, is_identified);
    output.result(&torque_table(found, joints))?;
    output.result(&format!(
        "\nContact threshold: {threshold:.1} standard deviations ({source}).\n"
    ))?;
    output.result(&match contacts.is_empty() {
        true => nothing_found(found, from),
        false => contact_table(contacts),
    })?;
    match &args.output {
        Some(path) => output.result(&format!("The torques are in `{}`.\n", path.display())),
        None => Ok(()),
    }
}

/// The format that belongs to the ending of the output file.
fn format_of(path: &Path) -> Result<TorqueFormat, CliError> {
    let formats = [
        ("csv", TorqueFormat::Csv),
        ("parquet", TorqueFormat::Parquet),
        ("mcap", TorqueFormat::Mcap),
    ];
    let format = file_paths::format_of(path, "file of torques", &formats)?;
    if format == TorqueFormat::Parquet && !cfg!(feature = "full") {
        return Err(CliError::Usage(palpate_io::not_built("Parquet")));
    }
    Ok(format)
}

/// Opens logs that give external torques; also returns their arm and the model of the torques.
fn open(
    paths: &[PathBuf],
    settings: &mut Settings,
    differentiation: Differentiation,
    output: &Output,
) -> Result<(Touches, Arc<Arm>, TorqueModel), CliError> {
    let (mut touches, arm) = logs::open_undecided(paths, settings, output)?;
    let model = arm_file::or_urdf(&settings.robot, &arm.robot, output)?;
    touches.decide_convention(&arm, Some((model.clone(), differentiation)), settings, output)?;
    Ok((touches, arm, model.for_differentiation(differentiation)))
}

fn rows<'a>(found: &'a [TouchTorques], threshold: f64, link: &'a str) -> Vec<TorqueRow<'a>> {
    let rows = found.iter().flat_map(|touch| {
        touch.frames.iter().map(move |frame| TorqueRow {
            touch: &touch.name,
            time_s: frame.time_s,
            q: &frame.q,
            torque: frame.external.torque.as_slice(),
            std: frame.external.std.as_slice(),
            statistic: frame.statistic,
            touched: frame.statistic > threshold,
            wrench: frame.wrench.map(|wrench| WrenchRow {
                link,
                in_base: wrench.in_base.into(),
                in_link: wrench.in_link.into(),
            }),
        })
    });
    rows.collect()
}

/// The message if no contact was found, with the largest torque.
fn nothing_found(found: &[TouchTorques], from: ThresholdSource) -> String {
    let frames = found.iter().flat_map(|touch| {
        touch.frames.iter().enumerate().map(move |(sample, frame)| (touch, sample, frame))
    });
    let is_number =
        |(_, _, frame): &(&TouchTorques, usize, &TorqueFrame)| frame.statistic.is_finite();
    let nearest =
        frames.filter(is_number).max_by(|(_, _, a), (_, _, b)| a.statistic.total_cmp(&b.statistic));
    let Some((touch, sample, frame)) = nearest else {
        return "No contact was found.\n".to_owned();
    };
    let at = match frame.time_s {
        Some(time_s) => format!("at {time_s:.2} s"),
        None => format!("in sample {sample} (from 0)"),
    };
    let hint = match from {
        ThresholdSource::Guess => "",
        _ => " A higher --false-alarms lowers the threshold.",
    };
    format!(
        "No contact was found: the largest torque is {:.1} standard deviations, in {} {at}.{hint}\n",
        frame.statistic, touch.name
    )
}

/// `figure` of each joint's values over the samples of a touch.
fn of_joints(
    touch: &TouchTorques,
    of: fn(&TorqueFrame) -> &[f64],
    figure: impl Fn(&[f64]) -> f64,
) -> Vec<f64> {
    let n = touch.frames.first().map_or(0, |frame| of(frame).len());
    let values = |j: usize| touch.frames.iter().map(|frame| of(frame)[j]).collect::<Vec<_>>();
    (0..n).map(|j| figure(&values(j))).collect()
}

/// Root mean square of the external torque of each joint, N·m.
fn rms_torque(touch: &TouchTorques) -> Vec<f64> {
    let rms = |values: &[f64]| {
        let count = values.len().max(1) as f64;
        (values.iter().map(|value| value.powi(2)).sum::<f64>() / count).sqrt()
    };
    of_joints(touch, |frame| frame.external.torque.as_slice(), rms)
}

/// Median standard deviation of the external torque of each joint, N·m.
fn median_std(touch: &TouchTorques) -> Vec<f64> {
    let median = |values: &[f64]| median(values).unwrap_or(f64::NAN);
    of_joints(touch, |frame| frame.external.std.as_slice(), median)
}

/// What the contact threshold was found from.
fn threshold_source(from: ThresholdSource, per_hour: f64, is_identified: bool) -> String {
    match from {
        ThresholdSource::Guess if is_identified => {
            "a guess, since the arm was identified on logs without a clock, or on too short ones; give --free".to_owned()
        }
        ThresholdSource::Guess => "a guess; give --free, or identify the arm".to_owned(),
        ThresholdSource::Identification => format!(
            "expected false alarms: {per_hour} per hour, from the motion that identification held out"
        ),
        ThresholdSource::FreeLogs => {
            format!("expected false alarms: {per_hour} per hour, from the logs of --free")
        }
    }
}

/// The size of the external torque at each joint, for each touch.
fn torque_table(found: &[TouchTorques], joints: &[String]) -> String {
    let mut head = vec!["touch", "samples"];
    head.extend(joints.iter().map(String::as_str));
    let rows = found.iter().map(|touch| {
        let (torque, std) = (rms_torque(touch), median_std(touch));
        let each = torque.iter().zip(std).map(|(torque, std)| format!("{torque:.2} ({std:.2})"));
        [touch.name.clone(), touch.frames.len().to_string()].into_iter().chain(each).collect()
    });
    let title = "External torque, root mean square, N·m (in brackets: the median of its standard deviation)";
    format!("{title}\n\n{}", table(&head, rows))
}

/// The contacts, or the largest ones if there are many.
fn contact_table(contacts: &[ContactInterval]) -> String {
    let mut by_size: Vec<usize> = (0..contacts.len()).collect();
    by_size.sort_by(|a, b| contacts[*b].largest_n_m.total_cmp(&contacts[*a].largest_n_m));
    by_size.truncate(SHOWN_CONTACTS);
    by_size.sort_unstable();
    let shown = by_size.into_iter().map(|number| &contacts[number]);
    let rows = shown.map(|contact| {
        let [from, to] = match contact.time_s {
            Some(times_s) => times_s.map(|time_s| format!("{time_s:.2}")),
            None => contact.samples.map(|sample| sample.to_string()),
        };
        vec![contact.touch.clone(), from, to, format!("{:.2}", contact.largest_n_m)]
    });
    let unit = if contacts[0].time_s.is_some() { "s" } else { "sample" };
    let (from, to) = (format!("from {unit}"), format!("to {unit}"));
    let table = table(&["contact in", &from, &to, "largest N·m"], rows);
    let more = match contacts.len() > SHOWN_CONTACTS {
        true => {
            format!("These are the largest of {} contacts; --json lists all.\n", contacts.len())
        }
        false => String::new(),
    };
    format!("\n{table}{more}")
}
