//! A timer for periodic actions.

use std::time::{Duration, Instant};

/// Tracks when a periodic action is due.
#[derive(Debug, Clone)]
pub(crate) struct Timer {
    every: Duration,
    last: Option<Instant>,
}

impl Timer {
    /// An action that is due at once, and then once in each period `every`.
    pub(crate) fn new(every: Duration) -> Self {
        Self { every, last: None }
    }

    /// Whether the action is due at `now`; if so, the next period begins.
    pub(crate) fn is_due(&mut self, now: Instant) -> bool {
        let due = self.last.is_none_or(|last| now.saturating_duration_since(last) >= self.every);
        if due {
            self.last = Some(now);
        }
        due
    }

    /// Time until the action is due.
    pub(crate) fn left(&self, now: Instant) -> Duration {
        self.last.map_or(Duration::ZERO, |last| (last + self.every).saturating_duration_since(now))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_timer_is_due_at_once_and_then_after_each_period() {
        let start = Instant::now();
        let mut timer = Timer::new(Duration::from_secs(2));
        let due = [0, 1, 2, 3, 3, 7].map(|s| timer.is_due(start + Duration::from_secs(s)));
        assert_eq!(due, [true, false, true, false, false, true]);
        assert_eq!(timer.left(start + Duration::from_secs(8)), Duration::from_secs(1));
        assert_eq!(timer.left(start + Duration::from_secs(10)), Duration::ZERO);
    }
}
