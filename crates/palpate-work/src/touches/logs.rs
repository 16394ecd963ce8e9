//! The events of logs, one log after the other, which can be read ahead.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use palpate_io::log::{self, AngleUnit, Log, LogError, LogEvent, LogOptions, LoggedTorques};

/// The number of a log, and an event of it.
type Numbered = (usize, LogEvent);

/// Logs that are read as one.
#[derive(Default)]
pub(super) struct Logs {
    logs: Vec<(PathBuf, Box<dyn Log>)>,
    /// Options of each log; `None` for touches in memory.
    options: Vec<Option<LogOptions>>,
    /// Whether the unit of positions is given for each log, by the settings, the names of its columns or the type of
    /// its messages.
    unit_said: Vec<bool>,
    /// Number of the log that is being read.
    reading: usize,
    /// Events that were read and not handed on yet, and the error after them.
    ahead: VecDeque<Numbered>,
    failed: Option<(usize, LogError)>,
    /// Whether positions without a given unit are degrees.
    in_degrees: bool,
}

impl Logs {
    pub(super) fn new(logs: Vec<(PathBuf, Box<dyn Log>)>, options: Option<&LogOptions>) -> Self {
        let unit = options.and_then(|options| options.angle_unit);
        let unit_said = logs.iter().map(|(_, log)| unit.or(log.describe().angle_unit).is_some());
        let options = vec![options.cloned(); logs.len()];
        Self { unit_said: unit_said.collect(), logs, options, ..Self::default() }
    }

    /// Begins anew with measured torques, which contain gravity, in place of external torques, if every log of external
    /// torques holds both; returns the path of the first such log.
    pub(super) fn read_measured(&mut self) -> Result<Option<PathBuf>, LogError> {
        let is_external =
            |log: &dyn Log| matches!(log.describe().torques, LoggedTorques::External(_));
        let Some((first, _)) = self.logs.iter().find(|(_, log)| is_external(log.as_ref())) else {
            return Ok(None);
        };
        let first = first.clone();
        let mut measured = Vec::new();
        for ((path, log), options) in self.logs.iter().zip(&self.options) {
            let Some(options) = options else { return Ok(None) };
            let measured_torques = is_external(log.as_ref());
            let options = LogOptions { measured_torques, ..options.clone() };
            let again = log::open(path, &options)?;
            if is_external(again.as_ref()) {
                return Ok(None);
            }
            measured.push((path.clone(), again));
        }
        (self.logs, self.reading, self.failed) = (measured, 0, None);
        self.ahead.clear();
        Ok(Some(first))
    }

    /// Adds logs that were not read from yet.
    pub(super) fn join(&mut self, other: Self) {
        self.logs.extend(other.logs);
        self.unit_said.extend(other.unit_said);
        self.options.extend(other.options);
    }

    /// Takes positions without a given unit for degrees: turns those that were read ahead, and all that follow, into
    /// radians.
    pub(super) fn are_in_degrees(&mut self) {
        self.in_degrees = true;
        let unsaid = self.ahead.iter_mut().filter(|(log, _)| !self.unit_said[*log]);
        unsaid.for_each(|(_, event)| into_rad(event));
    }

    /// Whether the unit of the positions of a log is not given.
    pub(super) fn lacks_unit(&self, log: usize) -> bool {
        !self.unit_said[log]
    }

    /// Number of logs of which samples were read.
    pub(super) fn begun(&self) -> usize {
        self.logs.len().min(self.reading + 1)
    }

    /// The logs with their paths.
    pub(super) fn all(&self) -> impl Iterator<Item = &(PathBuf, Box<dyn Log>)> {
        self.logs.iter()
    }

    /// Path of a log; that of the last one if there is no log of this number.
    pub(super) fn path(&self, log: usize) -> &Path {
        &self.logs[log.min(self.logs.len().saturating_sub(1))].0
    }

    /// The next event, `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Numbered>, (usize, LogError)> {
        match (self.ahead.pop_front(), self.failed.take()) {
            (Some(next), failed) => {
                self.failed = failed;
                Ok(Some(next))
            }
            (None, Some(failed)) => Err(failed),
            (None, None) => self.read(),
        }
    }

    /// Reads ahead until `samples` samples or the end, and returns the events that were read and not handed on yet.
    pub(super) fn look_ahead(&mut self, samples: usize) -> impl Iterator<Item = &LogEvent> {
        let is_sample = |event: &LogEvent| matches!(event, LogEvent::Sample(_));
        let mut found = self.ahead.iter().filter(|(_, event)| is_sample(event)).count();
        while found < samples && self.failed.is_none() {
            match self.read() {
                Ok(Some((log, event))) => {
                    found += usize::from(is_sample(&event));
                    self.ahead.push_back((log, event));
                }
                Ok(None) => break,
                Err(failed) => self.failed = Some(failed),
            }
        }
        self.ahead.iter().map(|(_, event)| event)
    }

    /// The events of one log that were read ahead.
    pub(super) fn ahead_of(&self, log: usize) -> impl Iterator<Item = &LogEvent> {
        self.ahead.iter().filter(move |(of, _)| *of == log).map(|(_, event)| event)
    }

    /// As [`Self::look_ahead`], but returns only events of logs without a given unit of positions.
    pub(super) fn look_ahead_in_unknown_unit(&mut self, samples: usize) -> Vec<&LogEvent> {
        let _ = self.look_ahead(samples);
        let unsaid = self.ahead.iter().filter(|(log, _)| !self.unit_said[*log]);
        unsaid.map(|(_, event)| event).collect()
    }

    fn read(&mut self) -> Result<Option<Numbered>, (usize, LogError)> {
        while let Some((_, log)) = self.logs.get_mut(self.reading) {
            match log.next().transpose() {
                Ok(None) => self.reading += 1,
                Ok(Some(mut event)) => {
                    if self.in_degrees && !self.unit_said[self.reading] {
                        into_rad(&mut event);
                    }
                    return Ok(Some((self.reading, event)));
                }
                Err(error) => return Err((self.reading, error)),
            }
        }
        Ok(None)
    }
}

fn into_rad(event: &mut LogEvent) {
    if let LogEvent::Sample(sample) = event {
        AngleUnit::Deg.into_rad(&mut sample.q);
    }
}
