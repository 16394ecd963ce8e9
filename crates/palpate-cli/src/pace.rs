//! `--rate`: replays fill the remaining time of each step.
//!
//! A robot reports at a fixed rate, and a mapper that has learnt a sample before the next one arrives can
//! use the remaining time for replays. Under a pace their number is not fixed: after each step,
//! [`Pace::fill`] grants replays as long as the next one is expected to end before the deadline. So the
//! field depends on the speed of the machine, and two runs differ; every result says so ([`ORIGIN`]).
//!
//! `map` makes any number of replays, since a replay does not count data twice. `ekf` counts data again
//! with every replay, so it makes at most the number in the setting `replays` for each frame. A step
//! without anything to replay ends early.

use std::time::{Duration, Instant};

use palpate::{EstimatorKind, Mapper, ReplayPolicy, StepReport};
use serde::Serialize;

use crate::args::number_in;
use crate::interrupt;
use palpate_work::quantile::median;

/// The note on every result that was made under a pace.
pub(crate) const ORIGIN: &str = "Under --rate the field depends on the speed of the machine.";

/// Least ratio of the remaining time to the mean time of a visit at which another visit is made: frames
/// differ in size, and the next one may be large.
const MARGIN: f64 = 2.0;
/// Largest number of visits between two readings of the clock.
const MAX_AT_ONCE: u32 = 8;
/// Weight of the latest visits in the running mean of their time.
const LATEST: f64 = 0.1;

/// The flag `--rate`.
#[derive(Debug, Clone, Copy, clap::Args)]
pub(crate) struct PaceArgs {
    /// Rate of the steps, from 0.1 to 100000 Hz: instead of a fixed number of replays, each step makes
    /// as many as fit into its remaining time (`ekf`: at most `replays`). The field then depends on
    /// the speed of the machine
    #[arg(long, value_name = "HZ", value_parser = number_in(0.1..=100_000.0, "a number from 0.1 to 100000 Hz"))]
    rate: Option<f64>,
}

impl PaceArgs {
    /// Leaves the replays of a mapper to a pace, if `--rate` is given.
    pub(crate) fn keep(&self, mapper: Mapper) -> (Mapper, Option<Pace>) {
        let Some(rate_hz) = self.rate else { return (mapper, None) };
        let replays = mapper.config().estimator.replays;
        let policy = policy(mapper.config().method);
        let pace = Pace { rate_hz, replays, visit_s: 0.0, tally: Tally::default() };
        (mapper.with_replays(policy), Some(pace))
    }
}

fn policy(method: EstimatorKind) -> ReplayPolicy {
    match method {
        EstimatorKind::Map | EstimatorKind::Elastic => ReplayPolicy::SpareTimeUnbounded,
        EstimatorKind::Ekf => ReplayPolicy::SpareTime,
    }
}

/// Fills the remaining time of steps with replays.
#[derive(Debug, Clone)]
pub(crate) struct Pace {
    rate_hz: f64,
    /// Replays for each frame in the settings.
    replays: u32,
    /// Running mean of the time of a visit, s; 0 before the first.
    visit_s: f64,
    tally: Tally,
}

/// Statistics of the steps so far.
#[derive(Debug, Clone, Default)]
struct Tally {
    /// Number of visits after each step with contact.
    replays: Vec<f64>,
    missed: u64,
    worst_overrun: Duration,
}

/// How well a pace was kept.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct PaceFigures {
    /// The requested rate, Hz.
    pub rate_hz: f64,
    /// Replays per step: median over the steps with contact.
    pub replays_median: f64,
    /// Number of steps that took longer than their period.
    pub missed: u64,
    /// Largest time by which a step exceeded its period, ms.
    pub worst_overrun_ms: f64,
}

impl Pace {
    /// Makes replays until the step that began at `started` has used up its time.
    ///
    /// `report` is that of the step. Ctrl-C ends the replays early.
    pub(crate) fn fill(&mut self, mapper: &mut Mapper, report: &StepReport, started: Instant) {
        let period = Duration::from_secs_f64(1.0 / self.rate_hz);
        let mut granted: Option<(Instant, u32)> = None;
        let made = mapper.spare_time(|left| {
            if let Some((since, visits)) = granted {
                self.learn_time(since.elapsed().as_secs_f64() / f64::from(visits));
            }
            if interrupt::pressed() {
                return 0;
            }
            let left_s = period.saturating_sub(started.elapsed()).as_secs_f64();
            let visits = self.affordable(left_s).min(left);
            granted = Some((Instant::now(), visits.max(1)));
            visits
        });
        if report.external.is_some() && report.contacts > 0 {
            self.tally.replays.push(f64::from(made));
        }
        let overrun = started.elapsed().saturating_sub(period);
        self.tally.missed += u64::from(!overrun.is_zero());
        self.tally.worst_overrun = self.tally.worst_overrun.max(overrun);
    }

    /// Makes the number of replays in the settings, however long they take.
    pub(crate) fn fill_as_set(&self, mapper: &mut Mapper) {
        let mut left = self.replays;
        mapper.spare_time(|_| std::mem::take(&mut left));
    }

    /// How well the pace was kept so far.
    pub(crate) fn figures(&self) -> PaceFigures {
        PaceFigures {
            rate_hz: self.rate_hz,
            replays_median: median(&self.tally.replays).unwrap_or(0.0),
            missed: self.tally.missed,
            worst_overrun_ms: self.tally.worst_overrun.as_secs_f64() * 1e3,
        }
    }

    /// Number of visits to make in the remaining time before the clock is read again.
    fn affordable(&self, left_s: f64) -> u32 {
        if left_s <= MARGIN * self.visit_s {
            return 0;
        }
        // One at a time near the end; the cast saturates the infinity before the first visit.
        let fitting = (left_s / self.visit_s / 4.0) as u32;
        if self.visit_s == 0.0 { 1 } else { fitting.clamp(1, MAX_AT_ONCE) }
    }

    /// Takes the time of the latest visits into the running mean.
    fn learn_time(&mut self, visit_s: f64) {
        let first = self.visit_s == 0.0;
        self.visit_s += if first { visit_s } else { LATEST * (visit_s - self.visit_s) };
    }
}

impl PaceFigures {
    /// The figures in one line.
    pub(crate) fn text(&self) -> String {
        let Self { rate_hz, replays_median, missed, worst_overrun_ms } = self;
        let kept = match missed {
            0 => "no deadline missed".to_owned(),
            _ => format!("{missed} deadlines missed, the worst by {worst_overrun_ms:.3} ms"),
        };
        format!("{rate_hz} Hz: {replays_median} replays a step (median), {kept}")
    }
}

#[cfg(test)]
mod tests {
    use palpate::MapperConfig;

    use super::*;
    use crate::example;

    fn pace(visit_s: f64) -> Pace {
        Pace { rate_hz: 20.0, replays: 5, visit_s, tally: Tally::default() }
    }

    #[test]
    fn no_visit_is_begun_that_would_pass_the_deadline() {
        let pace = pace(1e-3);
        for left_s in [0.0, 0.5e-3, 1e-3, 3e-3, 10e-3, 1.0] {
            let visits = pace.affordable(left_s);
            assert!(f64::from(visits) * pace.visit_s <= left_s, "{visits} in {left_s} s");
        }
        assert_eq!((pace.affordable(3e-3), pace.affordable(1.0)), (1, MAX_AT_ONCE));
    }

    #[test]
    fn the_first_visit_is_made_alone_to_learn_its_time() {
        let mut pace = pace(0.0);
        assert_eq!((pace.affordable(0.0), pace.affordable(1e-3)), (0, 1));
        pace.learn_time(2e-3);
        assert_eq!(pace.visit_s, 2e-3);
        pace.learn_time(4e-3);
        assert!(pace.visit_s > 2e-3 && pace.visit_s < 4e-3);
    }

    #[test]
    fn only_map_makes_any_number_of_replays() {
        let mapper = || {
            let config = MapperConfig::of(EstimatorKind::Map);
            Mapper::new(example::arm().into(), config).unwrap()
        };
        let pace = |rate| PaceArgs { rate }.keep(mapper()).1;
        assert!(pace(None).is_none() && pace(Some(17.0)).is_some());
        assert_eq!(policy(EstimatorKind::Map), ReplayPolicy::SpareTimeUnbounded);
        assert_eq!(policy(EstimatorKind::Ekf), ReplayPolicy::SpareTime);
    }
}
