//! Processing that is common to logs of all formats: units of angles and times, clock, gaps in time.
//!
//! A format supplies touches and samples as they are logged ([`Source`]). The reader converts
//! angles to radians and times to seconds, warns of a clock that stands still or runs backwards, starts a new touch at
//! gaps in time if the options say so, and ends a log at its first error.

use std::collections::VecDeque;

use palpate::Sample;

use super::clock::ClockEvidence;
use super::error::LogError;
use super::event::{Log, LogDescription, LogEvent, LogWarning};
use super::options::{AngleUnit, LogOptions, TimeUnit};

/// Most samples that are read ahead to find the unit of times: 20 MB for seven joints.
const AHEAD: usize = 100_000;

/// A log in one format, before the processing by [`Reader`].
pub(super) trait Source: Send {
    /// Description of the log.
    fn describe(&self) -> LogDescription;

    /// Reads until `events` is not empty; if it stays empty, the log has ended.
    fn read_on(
        &mut self,
        events: &mut VecDeque<LogEvent>,
        warnings: &mut Vec<LogWarning>,
    ) -> Result<(), LogError>;

    /// Ticks per second of the times in the file that is being read, if they were guessed from the size of the first
    /// time.
    fn guessed_ticks_per_s(&self) -> Option<f64> {
        None
    }
}

/// A log being read.
pub(super) struct Reader {
    source: Box<dyn Source>,
    angle_unit: Option<AngleUnit>,
    split_gap_s: Option<f64>,
    /// Whether the first samples were read ahead to find the unit of times.
    looked_ahead: bool,
    /// The unit of times that was found, and the number by which the source's times are divided to give s.
    time_unit: Option<(TimeUnit, f64)>,
    /// Events that are read but not returned yet, and the error after them.
    events: VecDeque<LogEvent>,
    failed: Option<LogError>,
    /// The first sample after a gap, to be returned after the start of its touch.
    after_gap: Option<LogEvent>,
    touch: Touch,
    warnings: Vec<LogWarning>,
    over: bool,
}

/// The current touch of the log, before it is split at gaps.
#[derive(Default)]
struct Touch {
    name: String,
    joint_names: Option<Vec<String>>,
    /// Number of samples so far.
    samples: u64,
    /// Number of touches that it was split into so far.
    parts: u32,
    /// Time of the previous sample, s.
    before_s: Option<f64>,
    /// Whether there was a warning about its clock.
    warned: bool,
}

impl Reader {
    /// A reader before the first event.
    pub(super) fn new(source: Box<dyn Source>, options: &LogOptions) -> Self {
        Self {
            source,
            angle_unit: options.angle_unit,
            split_gap_s: options.split_gap_s,
            looked_ahead: false,
            time_unit: None,
            events: VecDeque::new(),
            failed: None,
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
        if !self.looked_ahead {
            self.looked_ahead = true;
            self.find_time_unit();
        }
        if self.events.is_empty() {
            match self.failed.take() {
                Some(failed) => return Err(failed),
                None => self.source.read_on(&mut self.events, &mut self.warnings)?,
            }
            if let (Some((unit, per_s)), guessed) =
                (&mut self.time_unit, self.source.guessed_ticks_per_s())
            {
                // A later file may name its unit.
                *per_s = guessed.map_or(1.0, |guessed_per_s| unit.per_s() / guessed_per_s);
            }
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

    /// Reads the first samples ahead, and finds the unit of their times, if it was guessed for all of them in the same
    /// way.
    fn find_time_unit(&mut self) {
        let mut evidence = ClockEvidence::default();
        let (mut samples, mut guess, mut more) = (0, None, VecDeque::new());
        while samples < AHEAD {
            if let Err(failed) = self.source.read_on(&mut more, &mut self.warnings) {
                self.failed = Some(failed);
                break;
            }
            if more.is_empty() {
                break;
            }
            let guessed = self.source.guessed_ticks_per_s();
            let is_known = guessed.is_none() || guess.is_some_and(|guess| Some(guess) != guessed);
            for event in &more {
                match event {
                    LogEvent::TouchStarts { .. } => evidence.touch_starts(),
                    LogEvent::Sample(sample) => {
                        evidence.add(sample, self.angle_unit.unwrap_or_default());
                        samples += 1;
                    }
                }
            }
            self.events.append(&mut more);
            if is_known {
                return;
            }
            guess = guessed;
        }
        let Some((odd, guess_per_s)) = evidence.odd().zip(guess) else { return };
        self.time_unit = odd.unit(guess_per_s).map(|unit| (unit, unit.per_s() / guess_per_s));
    }

    /// The event for a sample: the sample itself or, after a gap, the start of a touch before it.
    fn sample(&mut self, mut sample: Sample) -> Result<LogEvent, LogError> {
        if let Some(unit) = self.angle_unit {
            unit.into_rad(&mut sample.q);
        }
        if let (Some((_, per_s)), Some(time_s)) = (self.time_unit, &mut sample.time_s) {
            *time_s /= per_s;
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

    /// Warns, once per touch, if the time of a sample is not after that of the previous sample.
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

    fn found_time_unit(&self) -> Option<TimeUnit> {
        self.time_unit.map(|(unit, _)| unit)
    }
}
