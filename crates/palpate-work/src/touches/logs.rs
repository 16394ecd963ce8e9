//! The events of logs, one log after the other, which can be read ahead.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use palpate_io::log::{Log, LogError, LogEvent};

/// An event, and the number of the log that it is of.
type Numbered = (usize, LogEvent);

/// Logs that are read as one.
#[derive(Default)]
pub(super) struct Logs {
    logs: Vec<(PathBuf, Box<dyn Log>)>,
    /// The log that is read from.
    reading: usize,
    /// What was read and not handed on yet, and the error behind it.
    ahead: VecDeque<Numbered>,
    failed: Option<(usize, LogError)>,
}

impl Logs {
    pub(super) fn new(logs: Vec<(PathBuf, Box<dyn Log>)>) -> Self {
        Self { logs, ..Self::default() }
    }

    /// Adds logs that were not read from yet.
    pub(super) fn join(&mut self, other: Self) {
        self.logs.extend(other.logs);
    }

    /// The logs and where they are.
    pub(super) fn all(&self) -> impl Iterator<Item = &(PathBuf, Box<dyn Log>)> {
        self.logs.iter()
    }

    /// Where a log is, or the last one.
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

    /// Reads so many samples ahead, or all that there are, and returns what is ahead.
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

    fn read(&mut self) -> Result<Option<Numbered>, (usize, LogError)> {
        while let Some((_, log)) = self.logs.get_mut(self.reading) {
            match log.next().transpose() {
                Ok(None) => self.reading += 1,
                Ok(Some(event)) => return Ok(Some((self.reading, event))),
                Err(error) => return Err((self.reading, error)),
            }
        }
        Ok(None)
    }
}
