//! External torques of logs, sample by sample, with standard deviations, and the intervals of contact.

use std::collections::HashMap;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use nalgebra::DVector;
use palpate::unstable::LinkId;
use palpate::{Arm, ExternalTorque, FalseAlarmModel, LinkWrench, Robot, TorqueModel, TrackerError};
use serde::Serialize;

use crate::error::WorkError;
use crate::progress::Progress;
use crate::quantile::median;
use crate::touches::RecordedTouch;

/// Threshold for contact in standard deviations, if there is no contact-free motion to find it from.
const USUAL_THRESHOLD: f64 = 6.0;

/// What a threshold was found from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ThresholdSource {
    /// Logs in which nothing is touched.
    FreeLogs,
    /// Motion that identification held out.
    Identification,
    /// No data: it is a guess.
    Guess,
}

/// Largest plausible share of samples in contact; beyond it, a warning is given.
const ALWAYS: f64 = 0.8;

/// Threshold, in standard deviations, above which a note says from which torques contacts are found.
const HIGH_THRESHOLD: f64 = 15.0;

/// Shortest time, and fewest samples if there are no times, between two contact intervals; closer ones are merged.
const APART_S: f64 = 0.25;
const APART_SAMPLES: usize = 10;

/// Allowed range of false alarms per hour.
pub const FALSE_ALARMS_PER_HOUR: RangeInclusive<f64> = 1e-6..=3600.0;
/// Allowed range of bandwidths, Hz.
pub const BANDWIDTH_HZ: RangeInclusive<f64> = 1e-3..=1e5;

/// How external torques are processed.
#[derive(Debug, Clone, Copy)]
pub struct TorqueSettings {
    /// First-order low-pass of the external torques, Hz.
    pub bandwidth_hz: Option<f64>,
    /// Number of samples at the start of each touch whose mean torque is subtracted.
    pub tare_frames: usize,
    /// Link at whose origin the wrench is given.
    pub wrench_link: Option<LinkId>,
}

/// External torques of a touch.
#[derive(Debug, Clone)]
pub struct TouchTorques {
    /// The log with the touch.
    pub log: PathBuf,
    /// Name of the touch.
    pub name: String,
    /// External torque of each sample.
    pub frames: Vec<TorqueFrame>,
}

/// External torque at a sample.
#[derive(Debug, Clone)]
pub struct TorqueFrame {
    /// Time by the log's clock, s.
    pub time_s: Option<f64>,
    /// Joint positions, n_joints, rad or m.
    pub q: Vec<f64>,
    /// External torque with its standard deviation, n_joints, N·m.
    pub external: ExternalTorque,
    /// Largest ratio of |torque| to its standard deviation over the joints.
    pub statistic: f64,
    /// Wrench at the link of the settings that explains the torque best.
    pub wrench: Option<LinkWrench>,
}

/// A time interval of contact.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ContactInterval {
    /// The log with the touch.
    pub log: PathBuf,
    /// Name of the touch.
    pub touch: String,
    /// Number of the first and the last sample in the touch, from 0.
    pub samples: [usize; 2],
    /// Times of these samples, s; `None` without times.
    pub time_s: Option<[f64; 2]>,
    /// Largest norm of the external torque in the interval, N·m.
    pub largest_n_m: f64,
}

/// External torques of touches whose samples hold external torques with standard deviations
/// (`Touches::use_arm_model`).
///
/// # Errors
///
/// If a sample does not fit the robot.
pub fn torques(
    arm: &Arm,
    touches: &[RecordedTouch],
    settings: &TorqueSettings,
    progress: &dyn Progress,
) -> Result<Vec<TouchTorques>, WorkError> {
    if let Some(bandwidth_hz) = settings.bandwidth_hz {
        check_range("bandwidth_hz", bandwidth_hz, &BANDWIDTH_HZ)?;
    }
    let of_touch = |touch: &RecordedTouch| {
        let n = arm.robot.n_joints();
        let first = touch.samples.get(..settings.tare_frames).ok_or_else(|| {
            let found = touch.samples.len() as u32;
            let error = TrackerError::TareTooLong { found, wanted: settings.tare_frames as u32 };
            touch.fault(format!("touch `{}`", touch.name), error.into())
        })?;
        let mut tare = DVector::zeros(n);
        for sample in first {
            tare += DVector::from_column_slice(&sample.tau) / first.len() as f64;
        }
        let mut slow: Option<(DVector<f64>, Option<f64>)> = None;
        let frames = touch.samples.iter().enumerate().map(|(number, sample)| {
            let fault = |error: TrackerError| {
                touch.fault(
                    format!("touch `{}`, sample {number} (from 0)", touch.name),
                    error.into(),
                )
            };
            let raw = DVector::from_column_slice(&sample.tau) - &tare;
            let torque = match (&slow, settings.bandwidth_hz) {
                (Some((last, then)), Some(bandwidth_hz)) => {
                    let passed_s = sample.time_s.zip(*then).map_or(0.0, |(now, then)| now - then);
                    let part =
                        1.0 - (-std::f64::consts::TAU * bandwidth_hz * passed_s.max(0.0)).exp();
                    last + part * (raw - last)
                }
                _ => raw,
            };
            slow = Some((torque.clone(), sample.time_s));
            let std =
                DVector::from_vec(sample.tau_std.clone().unwrap_or_else(|| vec![f64::NAN; n]));
            let external = ExternalTorque { torque, std };
            let wrench = match settings.wrench_link {
                Some(link) => {
                    let poses = arm.robot.forward(&sample.q).map_err(TrackerError::from);
                    Some(external.wrench_at(&arm.robot, &poses.map_err(fault)?, link))
                }
                None => None,
            };
            let statistic = external.statistic();
            Ok(TorqueFrame {
                time_s: sample.time_s,
                q: sample.q.clone(),
                external,
                statistic,
                wrench,
            })
        });
        let frames = frames.collect::<Result<_, WorkError>>()?;
        Ok(TouchTorques { log: touch.log.clone(), name: touch.name.clone(), frames })
    };
    let mut found = touches.iter().map(of_touch).collect::<Result<Vec<_>, WorkError>>()?;
    rename_alike(&mut found);
    warn_of_untimed(&found, progress);
    Ok(found)
}

/// Warns if a threshold does not fit the torques of the touches, and notes if it is high.
pub fn judge_threshold(
    touches: &[TouchTorques],
    joints: &[String],
    (threshold, from): (f64, ThresholdSource),
    settings: &TorqueSettings,
    progress: &dyn Progress,
) {
    if settings.bandwidth_hz.is_some() && from == ThresholdSource::Identification {
        progress.warn(
            "the contact threshold was determined on unfiltered torques, so filtered torques cause fewer false alarms \
             than --false-alarms; give --free to determine it on filtered torques",
        );
    }
    warn_if_always_touched(touches, (threshold, from), progress);
    if let Some(note) = high_threshold(touches, joints, (threshold, from)) {
        progress.note(&note);
    }
}

/// Warns if nearly all samples exceed a threshold that was found from free motion.
fn warn_if_always_touched(
    touches: &[TouchTorques],
    (threshold, from): (f64, ThresholdSource),
    progress: &dyn Progress,
) {
    if from == ThresholdSource::Guess {
        return; // friction is still in the torques
    }
    let frames = || touches.iter().flat_map(|touch| &touch.frames);
    let touched = frames().filter(|frame| frame.statistic > threshold).count() as f64;
    let part = touched / frames().count().max(1) as f64;
    if part > ALWAYS {
        progress.warn(&format!(
            "in {:.0} % of the samples the torques are larger than those of free motion: is it another robot, does it \
             carry something else than when it was identified, or are the torques of other joints or in another unit?",
            100.0 * part
        ));
    }
}

/// From which torque of each joint contacts are found, as a note for the user; `None` unless the threshold is high.
fn high_threshold(
    touches: &[TouchTorques],
    joints: &[String],
    (threshold, from): (f64, ThresholdSource),
) -> Option<String> {
    let motion = match from {
        ThresholdSource::Guess => return None,
        ThresholdSource::FreeLogs => "the logs of --free are",
        ThresholdSource::Identification => "the motion that identification held out is",
    };
    let each = joints.iter().enumerate().filter_map(|(j, joint)| {
        let frames = touches.iter().flat_map(|touch| &touch.frames);
        let std: Vec<f64> = frames.map(|frame| frame.external.std[j]).collect();
        Some(format!("{:.1} at {joint}", threshold * median(&std)?))
    });
    let each = each.collect::<Vec<_>>().join(", ");
    (threshold > HIGH_THRESHOLD).then(|| {
        format!(
            "the contact threshold is {threshold:.0} standard deviations, so contacts are found only from about these \
             torques, N·m: {each}; {motion} short, or a few of its residuals are far larger than the others, often \
             where a joint reverses or stops; several minutes of contact-free motion like your task (--free) may lower \
             the threshold, and a higher --false-alarms lowers it"
        )
    })
}

fn warn_of_untimed(touches: &[TouchTorques], progress: &dyn Progress) {
    let untimed = |touch: &&TouchTorques| {
        touch.frames.iter().any(|frame| frame.time_s.is_none())
            || touch.frames.windows(2).any(|pair| pair[1].time_s < pair[0].time_s)
    };
    if let Some(touch) = touches.iter().find(untimed) {
        progress.warn(&format!(
            "`{}`: touch `{}` has no time stamps, or they run backwards: viscous friction and inertia stay in its \
             torques, and its contacts may be false alarms",
            touch.log.display(),
            touch.name
        ));
    }
}

/// Makes equal names of touches differ: puts the name of the log before them, and appends numbers if they are still
/// equal.
fn rename_alike(touches: &mut [TouchTorques]) {
    let counted = |touches: &[TouchTorques]| {
        let mut counts: HashMap<String, usize> = HashMap::new();
        touches.iter().for_each(|touch| *counts.entry(touch.name.clone()).or_default() += 1);
        counts
    };
    let counts = counted(touches);
    for touch in touches.iter_mut().filter(|touch| counts[&touch.name] > 1) {
        let log = touch.log.file_stem().map_or("log".into(), |log| log.to_string_lossy());
        touch.name = format!("{log}/{}", touch.name);
    }
    let counts = counted(touches);
    let mut seen: HashMap<String, usize> = HashMap::new();
    for touch in touches.iter_mut().filter(|touch| counts[&touch.name] > 1) {
        let number = seen.entry(touch.name.clone()).or_default();
        *number += 1;
        touch.name = format!("{}/{number}", touch.name);
    }
}

/// Refuses a number out of its range, with the name of its key.
pub(crate) fn check_range(
    key: &str,
    value: f64,
    range: &RangeInclusive<f64>,
) -> Result<(), WorkError> {
    if range.contains(&value) {
        return Ok(());
    }
    let (low, high) = (range.start(), range.end());
    Err(WorkError::Usage(format!("{key} is {value}; wanted a number from {low} to {high}")))
}

/// The link of this name, at whose origin a wrench is wanted.
///
/// # Errors
///
/// If the robot has no such link.
pub fn wrench_link(robot: &Robot, name: &str) -> Result<LinkId, WorkError> {
    robot.link_id(name).ok_or_else(|| {
        let names: Vec<&str> = robot.links().iter().map(|link| &*link.name).collect();
        let names = names.join(", ");
        WorkError::Usage(format!(
            "the robot has no link `{name}` (--wrench-link); there are {names}"
        ))
    })
}

/// The threshold, in standard deviations, that contact-free motion exceeds `false_alarms_per_hour` times an hour, and
/// what it was found from.
///
/// # Errors
///
/// If the rate is out of its range, or the contact-free logs are too short.
pub fn threshold(
    model: &TorqueModel,
    free: Option<&[TouchTorques]>,
    false_alarms_per_hour: f64,
) -> Result<(f64, ThresholdSource), WorkError> {
    check_range("false_alarms_per_hour", false_alarms_per_hour, &FALSE_ALARMS_PER_HOUR)?;
    let Some(free) = free else {
        return Ok(match &model.alarm {
            Some(alarm) => {
                (alarm.threshold(false_alarms_per_hour), ThresholdSource::Identification)
            }
            None => (USUAL_THRESHOLD, ThresholdSource::Guess),
        });
    };
    let timed = |touch: &TouchTorques| -> Vec<(f64, f64)> {
        touch.frames.iter().filter_map(|frame| Some((frame.time_s?, frame.statistic))).collect()
    };
    let alarm = FalseAlarmModel::of(&free.iter().map(timed).collect::<Vec<_>>()).ok_or_else(|| {
        WorkError::Usage(
            "the contact-free logs (--free) last less than 5 s by their clock: too short to determine how often \
             they pass a threshold"
                .to_owned(),
        )
    })?;
    Ok((alarm.threshold(false_alarms_per_hour), ThresholdSource::FreeLogs))
}

/// Intervals in which the threshold is exceeded; those less than 0.25 s apart (10 samples if there are no times) are
/// merged.
pub fn contacts(touches: &[TouchTorques], threshold: f64) -> Vec<ContactInterval> {
    let mut contacts: Vec<ContactInterval> = Vec::new();
    for touch in touches {
        let before = contacts.len();
        for (sample, frame) in touch.frames.iter().enumerate() {
            if frame.statistic <= threshold {
                continue;
            }
            let largest_n_m = frame.external.torque.norm();
            let last = contacts[before..].last_mut().filter(|last| {
                let then = touch.frames[last.samples[1]].time_s;
                match then.zip(frame.time_s) {
                    Some((then, now)) => now - then < APART_S,
                    None => sample - last.samples[1] < APART_SAMPLES,
                }
            });
            let time_s = frame.time_s;
            match last {
                Some(last) => {
                    last.samples[1] = sample;
                    last.time_s = last.time_s.zip(time_s).map(|([from, _], to)| [from, to]);
                    last.largest_n_m = last.largest_n_m.max(largest_n_m);
                }
                None => contacts.push(ContactInterval {
                    log: touch.log.clone(),
                    touch: touch.name.clone(),
                    samples: [sample, sample],
                    time_s: time_s.map(|time_s| [time_s, time_s]),
                    largest_n_m,
                }),
            }
        }
    }
    contacts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_high_threshold_is_named_in_torques() {
        let frame = |std: f64| TorqueFrame {
            time_s: None,
            q: vec![0.0],
            external: ExternalTorque {
                torque: DVector::zeros(1),
                std: DVector::from_element(1, std),
            },
            statistic: 0.0,
            wrench: None,
        };
        let frames = [0.5, 0.4, 9.0].map(frame).to_vec();
        let touch = TouchTorques { log: PathBuf::new(), name: "x".to_owned(), frames };
        let joints = ["elbow".to_owned()];
        let note = |threshold: f64, from: ThresholdSource| {
            high_threshold(std::slice::from_ref(&touch), &joints, (threshold, from))
        };
        let found = note(38.1, ThresholdSource::Identification).unwrap();
        assert!(found.contains("38 standard") && found.contains("19.1 at elbow"), "{found}");
        assert!(note(38.1, ThresholdSource::FreeLogs).unwrap().contains("of --free are"));
        assert_eq!(note(14.0, ThresholdSource::Identification), None);
        assert_eq!(note(38.1, ThresholdSource::Guess), None);
    }
}
