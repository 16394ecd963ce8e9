//! Touches parted where the clock leaps: for logs of any format that name none themselves.

use super::{Log, LogDescription, LogError, LogEvent, LogWarning};

/// A log in which a new touch starts after every pause in its samples.
pub(super) struct GapSplit {
    log: Box<dyn Log>,
    gap_s: f64,
    before_s: Option<f64>,
    touch: String,
    joint_names: Option<Vec<String>>,
    /// Touches that the one under way has become.
    parts: u32,
    /// A sample whose touch has just been announced.
    waiting: Option<LogEvent>,
    failed: bool,
}

impl GapSplit {
    /// Parts touches where two samples lie more than `gap_s` apart.
    pub(super) fn new(log: Box<dyn Log>, gap_s: f64) -> Self {
        let (touch, joint_names) = (String::new(), None);
        Self {
            log,
            gap_s,
            before_s: None,
            touch,
            joint_names,
            parts: 0,
            waiting: None,
            failed: false,
        }
    }

    fn take(&mut self, event: LogEvent) -> Result<LogEvent, LogError> {
        match &event {
            LogEvent::TouchStarts { name, joint_names } => {
                self.touch.clone_from(name);
                self.joint_names.clone_from(joint_names);
                (self.before_s, self.parts) = (None, 1);
                Ok(event)
            }
            LogEvent::Sample(sample) => {
                let Some(now_s) = sample.time_s else {
                    self.failed = true;
                    return Err(LogError::NoClock { path: self.log.describe().path });
                };
                let leaps = self.before_s.is_some_and(|before_s| now_s - before_s > self.gap_s);
                self.before_s = Some(now_s);
                if !leaps {
                    return Ok(event);
                }
                self.parts += 1;
                let name = format!("{}_{}", self.touch, self.parts);
                self.waiting = Some(event);
                Ok(LogEvent::TouchStarts { name, joint_names: self.joint_names.clone() })
            }
        }
    }
}

impl Iterator for GapSplit {
    type Item = Result<LogEvent, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.failed {
            return None;
        }
        if let Some(event) = self.waiting.take() {
            return Some(Ok(event));
        }
        let event = self.log.next()?;
        Some(event.and_then(|event| self.take(event)))
    }
}

impl Log for GapSplit {
    fn describe(&self) -> LogDescription {
        LogDescription { touches: None, ..self.log.describe() }
    }

    fn warnings(&self) -> &[LogWarning] {
        self.log.warnings()
    }
}
