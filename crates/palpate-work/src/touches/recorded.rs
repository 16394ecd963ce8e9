//! Three forms of touches: events of a log, whole touches, and a log in memory that is made of these.

use std::iter::once;
use std::path::PathBuf;
use std::vec::IntoIter;

use palpate::{MapperError, Robot, Sample};
use palpate_io::log::{
    Log, LogDescription, LogError, LogEvent, LogFormat, LogWarning, LoggedTorques,
};

use crate::error::WorkError;

/// An event of logs.
pub enum TouchEvent {
    /// A touch with this name starts.
    Touch(String),
    /// The next sample of the touch.
    Sample(Sample),
}

/// A whole touch, read from a log or made by a program.
#[derive(Debug, Clone, Default)]
pub struct RecordedTouch {
    /// The log with the touch; empty if a program made it.
    pub log: PathBuf,
    /// Name of the touch.
    pub name: String,
    /// Names of the joints in the order of the samples, if they are known.
    pub joint_names: Option<Vec<String>>,
    /// The samples in order.
    pub samples: Vec<Sample>,
}

impl RecordedTouch {
    /// An error at a place of this touch.
    pub fn fault(&self, place: String, source: MapperError) -> WorkError {
        WorkError::touch(&self.log, place, source)
    }

    /// Removes whole turns from joint positions; see [`Robot::unwrap_angles`].
    pub(crate) fn unwrap_angles(&mut self, robot: &Robot) {
        let mut before: Option<&[f64]> = None;
        for sample in &mut self.samples {
            robot.unwrap_angles(before, &mut sample.q);
            before = Some(&sample.q);
        }
    }
}

/// Puts the joints of a sample into another order.
pub(crate) fn reorder_joints(sample: &mut Sample, order: &[usize]) {
    for values in [&mut sample.q, &mut sample.tau].into_iter().chain(&mut sample.tau_std) {
        *values = order.iter().map(|&place| values[place]).collect();
    }
}

/// Touches in memory as a log.
pub(crate) struct MemoryLog {
    events: IntoIter<LogEvent>,
    touches: usize,
    samples: u64,
}

impl MemoryLog {
    pub(crate) fn new(touches: Vec<RecordedTouch>) -> Self {
        let samples = touches.iter().map(|touch| touch.samples.len() as u64).sum();
        let count = touches.len();
        let events =
            touches.into_iter().flat_map(|RecordedTouch { name, joint_names, samples, .. }| {
                let start = LogEvent::TouchStarts { name, joint_names };
                once(start).chain(samples.into_iter().map(LogEvent::Sample))
            });
        let events: Vec<LogEvent> = events.collect();
        Self { events: events.into_iter(), touches: count, samples }
    }
}

impl Iterator for MemoryLog {
    type Item = Result<LogEvent, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.events.next().map(Ok)
    }
}

impl Log for MemoryLog {
    fn describe(&self) -> LogDescription {
        LogDescription {
            path: PathBuf::new(),
            format: LogFormat::Memory,
            touches: Some(self.touches),
            samples: Some(self.samples),
            joints: None,
            torques: LoggedTorques::Unknown,
            angle_unit: None,
            columns: None,
        }
    }

    fn warnings(&self) -> &[LogWarning] {
        &[]
    }
}
