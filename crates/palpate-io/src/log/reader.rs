//! What is done to a log of any format: the unit of its angles, its clock, and gaps in time.
//!
//! A format hands over touches and samples as they are logged ([`Source`]). The reader turns angles
//! into radians, warns of a clock that stands still, starts a new touch where the clock leaps, if
//! that was asked for, and ends a log at its first error.

use std::collections::VecDeque;

use palpate::Sample;

use super::error::LogError;
use super::event::{Log, LogDescription, LogEvent, LogWarning};
use super::options::{AngleUnit, LogOptions};

/// A log as its format has it.
pub(super) trait Source: Send {
    /// What is known of the log before it is read.
    fn describe(&self) -> LogDescription;

    /// Reads on until `events` holds something; nothing is the end.
    fn read_on(
        &mut self,
        events: &mut VecDeque<LogEvent>,
        warnings: &mut Vec<LogWarning>,
    ) -> Result<(), LogError>;
}

/// A log being read.
pub(super) struct Reader {
    source: Box<dyn Source>,
    angle_unit: Option<AngleUnit>,
    split_gap_s: Option<f64>,
    /// Events that are read and not handed on yet.
    events: VecDeque<LogEvent>,
    /// A sample whose touch, parted from the one before by a gap, has just been announced.
    after_gap: Option<LogEvent>,
    touch: Touch,
    warnings: Vec<LogWarning>,
    over: bool,
}

/// The touch under way, as the log has it.
#[derive(Default)]
struct Touch {
    name: String,
    joint_names: Option<Vec<String>>,
    /// Samples so far.
    samples: u64,
    /// Touches that gaps have made of it.
    parts: u32,
    /// Time of the sample before.
    before_s: Option<f64>,
    /// Whether its clock was warned of.
    warned: bool,
}

impl Reader {
    /// Stands before the first event.
    pub(super) fn new(source: Box<dyn Source>, options: &LogOptions) -> Self {
        Self {
            source,
            angle_unit: options.angle_unit,
            split_gap_s: options.split_gap_s,
            events: VecDeque::new(),
            after_gap: None,
            touch: Touch::default(),
            warnings: Vec::new(),
            over: false,
        }
    }

    /// The next event, or `None` at the end.
    fn advance(&mut self) -> Result<Option<LogEvent>, LogError> {
        if let Some(sample) = self.after_gap.take() {
            return Ok(Some(sample));
        }
        if self.events.is_empty() {
            self.source.read_on(&mut self.events, &mut self.warnings)?;
        }
        match self.events.pop_front() {
            None => Ok(None),
            Some(LogEvent::TouchStarts { name, joint_names }) => {
                let (named, parts) = (joint_names.clone(), 1);
                self.touch =
                    Touch { name: name.clone(), joint_names: named, parts, ..Touch::default() };
                Ok(Some(LogEvent::TouchStarts { name, joint_names }))
            }
            Some(LogEvent::Sample(sample)) => self.sample(sample).map(Some),
        }
    }

    /// The event of a sample: itself, or the start of a touch before it.
    fn sample(&mut self, mut sample: Sample) -> Result<LogEvent, LogError> {
        if let Some(unit) = self.angle_unit {
            unit.into_rad(&mut sample.q);
        }
        let before_s = std::mem::replace(&mut self.touch.before_s, sample.time_s);
        self.watch_clock(before_s, sample.time_s);
        self.touch.samples += 1;
        let Some(gap_s) = self.split_gap_s else { return Ok(LogEvent::Sample(sample)) };
        let Some(now_s) = sample.time_s else {
            return Err(LogError::NoClock { path: self.source.describe().path });
        };
        if before_s.is_none_or(|before_s| now_s - before_s <= gap_s) {
            return Ok(LogEvent::Sample(sample));
        }
        self.after_gap = Some(LogEvent::Sample(sample));
        self.touch.parts += 1;
        let name = format!("{}_{}", self.touch.name, self.touch.parts);
        Ok(LogEvent::TouchStarts { name, joint_names: self.touch.joint_names.clone() })
    }

    /// Warns, once a touch, if the time of a sample is not after that of the one before.
    fn watch_clock(&mut self, before_s: Option<f64>, now_s: Option<f64>) {
        let Some((before_s, now_s)) = before_s.zip(now_s).filter(|(before, now)| now <= before)
        else {
            return;
        };
        match self.warnings.last_mut() {
            Some(LogWarning::TimeNotIncreasing { count, .. }) if self.touch.warned => *count += 1,
            _ => self.warnings.push(LogWarning::TimeNotIncreasing {
                touch: self.touch.name.clone(),
                row: self.touch.samples,
                before_s,
                now_s,
                count: 1,
            }),
        }
        self.touch.warned = true;
    }
}

impl Iterator for Reader {
    type Item = Result<LogEvent, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.over {
            return None;
        }
        let event = self.advance();
        self.over = !matches!(event, Ok(Some(_)));
        event.transpose()
    }
}

impl Log for Reader {
    fn describe(&self) -> LogDescription {
        let description = self.source.describe();
        let touches = description.touches.filter(|_| self.split_gap_s.is_none());
        LogDescription { touches, ..description }
    }

    fn warnings(&self) -> &[LogWarning] {
        &self.warnings
    }
}
