//! A log held whole, its joints in the robot's order.
//!
//! What is wrong with a log shows only against all of it, so it is read into memory: 120 bytes a
//! frame of seven joints, which is a day at 20 Hz in 200 MB.

use std::collections::VecDeque;
use std::path::Path;

use palpate::{MapperError, Robot, Sample};
use palpate_io::log::{
    self, Format, LogError, LogEvent, LogOptions, LogWarning, LoggedTorques, reorder,
};
use serde::Serialize;

use super::super::finding::Finding;
use super::super::page::listed;
use crate::pauses::Pauses;
use crate::touches::TouchEvent;

/// The frames of one touch.
#[derive(Debug, Clone, Default)]
pub(super) struct Touch {
    pub name: String,
    pub joint_names: Option<Vec<String>>,
    /// As many as frames, or none at all if the log has no clock.
    pub times_s: Vec<f64>,
    pub q: Vec<Vec<f64>>,
    pub tau: Vec<Vec<f64>>,
}

/// All touches of a log, as far as it could be read.
#[derive(Debug)]
pub(super) struct Record {
    pub format: Format,
    pub touches: Vec<Touch>,
    /// What the log says of its torques.
    pub torques: LoggedTorques,
    /// What looked odd and did not stop the reading, but for the clock, which is looked at apart.
    pub warnings: Vec<String>,
    /// Where the reading ended early.
    pub broken: Option<LogError>,
}

/// How the joints of the log became those of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Matching {
    /// The log names no joints: its order is believed, and checked by gravity.
    Unnamed,
    /// By name, and their order is the robot's.
    InOrder,
    /// By name, and their order is another.
    Reordered,
    /// The names, or their number, do not serve the robot.
    Unmatched,
}

impl Touch {
    pub(super) fn frames(&self) -> usize {
        self.q.len()
    }

    pub(super) fn n_joints(&self) -> usize {
        self.q.first().map_or(0, Vec::len)
    }

    /// How many frames from the first on stay where it was.
    pub(super) fn still_frames(&self, still_rad: f64) -> usize {
        let Some(start) = self.q.first() else { return 0 };
        let moved = |q: &&Vec<f64>| farthest(q, start) > still_rad;
        self.q.iter().position(|q| moved(&q)).unwrap_or(self.frames())
    }

    /// Positions and torques of some of the joints, in another order.
    pub(super) fn permute(&mut self, order: &[usize]) {
        for row in self.q.iter_mut().chain(&mut self.tau) {
            *row = order.iter().map(|&place| row[place]).collect();
        }
    }
}

/// The largest difference of two joint vectors at any joint.
pub(super) fn farthest(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// Reads a log to its end, or to the first thing that cannot be read.
pub(super) fn read(path: &Path, options: &LogOptions) -> Result<Record, LogError> {
    let mut log = log::open(path, options)?;
    let (description, touches) = (log.describe(), Vec::new());
    let (format, torques) = (description.format, description.torques);
    let mut record = Record { format, torques, touches, warnings: Vec::new(), broken: None };
    for event in log.by_ref() {
        match event {
            Ok(LogEvent::TouchStarts { name, joint_names }) => {
                record.touches.push(Touch { name, joint_names, ..Touch::default() });
            }
            Ok(LogEvent::Sample(sample)) => {
                let touch = record.touches.last_mut().expect("samples come after a touch's start");
                touch.times_s.extend(sample.time_s);
                touch.q.push(sample.q);
                touch.tau.push(sample.tau);
            }
            Err(error) => record.broken = Some(error),
        }
    }
    record.touches.retain(|touch| touch.frames() > 0);
    let odd = log.warnings().iter();
    let odd = odd.filter(|odd| !matches!(odd, LogWarning::TimeNotIncreasing { .. }));
    record.warnings = odd.map(ToString::to_string).collect();
    Ok(record)
}

impl Touch {
    /// The frames as samples.
    fn samples(self) -> impl Iterator<Item = Sample> {
        let times_s = self.times_s.into_iter().map(Some).chain(std::iter::repeat(None));
        let frames = self.q.into_iter().zip(self.tau);
        frames.zip(times_s).map(|((q, tau), time_s)| Sample::new(time_s, q, tau))
    }
}

impl Record {
    /// Parts the touches where the arm pauses; joints must be the robot's.
    pub(super) fn part(&mut self, pauses: &mut Pauses) -> Result<(), MapperError> {
        let mut moments = VecDeque::new();
        for touch in std::mem::take(&mut self.touches) {
            let (name, joint_names) = (touch.name.clone(), touch.joint_names.clone());
            pauses.take(TouchEvent::Touch(name), &mut moments)?;
            for sample in touch.samples() {
                pauses.take(TouchEvent::Sample(sample), &mut moments)?;
            }
            pauses.finish(&mut moments);
            for moment in moments.drain(..) {
                match (moment, self.touches.last_mut()) {
                    (TouchEvent::Sample(sample), Some(touch)) => {
                        touch.times_s.extend(sample.time_s);
                        touch.q.push(sample.q);
                        touch.tau.push(sample.tau);
                    }
                    (TouchEvent::Sample(_), None) => {}
                    (TouchEvent::Touch(name), _) => {
                        let joint_names = joint_names.clone();
                        self.touches.push(Touch { name, joint_names, ..Touch::default() });
                    }
                }
            }
        }
        Ok(())
    }

    /// Puts the joints into the robot's order by name, if they have names, and says what of them
    /// does not serve the robot. Without a match they stay as they are.
    pub(super) fn match_joints(&mut self, robot: &Robot) -> (Matching, Vec<Finding>) {
        let joints: Vec<String> = robot.joint_names().map(str::to_owned).collect();
        let mut matching = Matching::Unnamed;
        let mut findings: Vec<Finding> = Vec::new();
        for touch in &mut self.touches {
            let Some(names) = &touch.joint_names else { continue };
            match reorder(&joints, names) {
                Ok(order) => {
                    let is_sorted = order.is_sorted();
                    touch.permute(&order);
                    if matching != Matching::Unmatched
                        && !(is_sorted && matching == Matching::Reordered)
                    {
                        matching = if is_sorted { Matching::InOrder } else { Matching::Reordered };
                    }
                }
                Err(error) => {
                    matching = Matching::Unmatched;
                    let what = error.to_string();
                    if findings.iter().all(|finding| finding.what != what) {
                        findings.push(unmatched(what, &joints));
                    }
                }
            }
        }
        if let Some(finding) = self.miscounted(robot).filter(|_| findings.is_empty()) {
            matching = Matching::Unmatched;
            findings.push(finding);
        }
        (matching, findings)
    }

    fn miscounted(&self, robot: &Robot) -> Option<Finding> {
        let (found, wanted) = (self.touches.first()?.n_joints(), robot.n_joints());
        (found != wanted).then(|| {
            let names: Vec<&str> = robot.joint_names().collect();
            let what = format!(
                "the log has {found} joints, the robot `{}` has {wanted}: {}",
                robot.name(),
                listed(&names)
            );
            let remedy = "name the right robot (--robot), or save only its joints; nothing that \
                          needs the robot was looked at";
            Finding::error("joint_count", what, remedy)
        })
    }
}

fn unmatched(what: String, joints: &[String]) -> Finding {
    let remedy = format!(
        "name the right robot (--robot), or the columns in the order {} (--columns \
         'q=...;tau=...'), which leaves names aside",
        joints.join(", ")
    );
    Finding::error("joint_names", what, remedy)
}
