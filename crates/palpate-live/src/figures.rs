//! Reports of a live session: notes, and figures of rates, latencies, losses and errors.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::session::{SessionState, StepOutcome};

/// Number of the latest steps over which latencies are evaluated.
const WINDOW: usize = 2000;

/// A report while a session runs.
#[derive(Debug, Clone)]
pub enum SessionEvent {
    /// Rates, latencies, losses and errors.
    Figures(Box<SessionFigures>),
    /// A message to the user.
    Note(String),
}

/// Median and 99th percentile of times, ms.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct MedianAndP99 {
    /// Median, ms.
    pub median: f64,
    /// 99th percentile, ms.
    pub p99: f64,
}

/// Figures of a session.
#[derive(Debug, Clone, Default, Serialize)]
pub struct SessionFigures {
    /// Time since the start, s.
    pub seconds: f64,
    /// State of the session.
    pub state: SessionState,
    /// Number of messages received.
    pub received: u64,
    /// Time since the last message that could be decoded, or since the start, s.
    pub silent_s: f64,
    /// Rate of messages over about the last half second, Hz.
    pub rate_hz: f64,
    /// Samples that were dropped because the mapper did not keep up.
    pub dropped: u64,
    /// Messages that never came, according to gaps in their sequence numbers.
    pub lost: u64,
    /// Messages that could not be used, by reason.
    pub refused: BTreeMap<&'static str, u64>,
    /// Samples processed by the session.
    pub mapped: u64,
    /// Touches begun.
    pub touches: u64,
    /// Number of cells touched now.
    pub contacts: usize,
    /// Number of cells touched so far.
    pub cells: usize,
    /// Time from the arrival of a sample to the publishing of its prediction.
    pub latency_ms: MedianAndP99,
    /// Duration of a step of the mapper.
    pub step_ms: MedianAndP99,
    /// Replays of remembered frames per sample, over about the last half second.
    pub replays: f64,
    /// Mean norm of τ̂ − τ_ext over the steps with contact, N·m; each sample is predicted before it
    /// is learnt.
    pub avg_error: Option<f64>,
    /// Mean norm of τ_ext over the same steps, N·m: the error of predicting zero.
    pub zero_avg_error: Option<f64>,
    /// Norm of τ_ext now, N·m.
    pub external_n_m: Option<f64>,
    /// Norm of τ̂ now, N·m.
    pub predicted_n_m: Option<f64>,
    /// Whether the guard's flag is up.
    pub stopped: bool,
    /// Why the flag is up.
    pub stop: Option<String>,
    /// Messages that were not sent since a queue was full.
    pub unsent: u64,
    /// Age of the last checkpoint, s.
    pub checkpoint_s: Option<f64>,
}

/// Collects the figures while a session runs.
#[derive(Debug)]
pub struct SessionCounters {
    /// Counts, and values of the last sample; the other figures are computed on request.
    figures: SessionFigures,
    started: Instant,
    replays: u64,
    latencies_ms: VecDeque<f64>,
    steps_ms: VecDeque<f64>,
    /// Sums of the errors of the steps with contact, N·m: of the prediction, and of predicting
    /// zero.
    errors: [f64; 2],
    steps_in_contact: u64,
    /// Time at which rates were last computed, and messages and replays until then.
    last: (Instant, u64, u64),
}

impl Default for SessionCounters {
    fn default() -> Self {
        let started = Instant::now();
        Self {
            figures: SessionFigures::default(),
            started,
            replays: 0,
            latencies_ms: VecDeque::new(),
            steps_ms: VecDeque::new(),
            errors: [0.0; 2],
            steps_in_contact: 0,
            last: (started, 0, 0),
        }
    }
}

impl SessionCounters {
    /// Counts a mapped sample, with its outcome and duration.
    pub fn step(&mut self, outcome: &StepOutcome, took: Duration) {
        keep(&mut self.steps_ms, took);
        let figures = &mut self.figures;
        figures.mapped += 1;
        figures.touches += u64::from(outcome.begins);
        figures.contacts = outcome.contacts;
        figures.external_n_m = outcome.torques.as_ref().map(|(external, _)| external.norm());
        figures.predicted_n_m = outcome.torques.as_ref().map(|(_, predicted)| predicted.norm());
        if let Some((external, predicted)) = &outcome.torques
            && outcome.contacts > 0
        {
            self.errors[0] += (predicted - external).norm();
            self.errors[1] += external.norm();
            self.steps_in_contact += 1;
        }
    }

    /// Counts a published prediction; `after` is its latency.
    pub fn published(&mut self, after: Duration) {
        keep(&mut self.latencies_ms, after);
    }

    /// Counts replays of remembered frames.
    pub fn replayed(&mut self, replays: u32) {
        self.replays += u64::from(replays);
    }

    /// Counts a message that cannot be used; returns whether it is the first for this reason.
    pub fn refuse(&mut self, reason: &'static str) -> bool {
        let count = self.figures.refused.entry(reason).or_default();
        *count += 1;
        *count == 1
    }

    /// The figures after `received` messages; those not collected here have default values.
    pub fn figures(&mut self, received: u64) -> SessionFigures {
        let (before, received_before, replays_before) = self.last;
        let elapsed_s = before.elapsed().as_secs_f64();
        if elapsed_s >= 0.5 {
            let samples = (received - received_before) as f64;
            let replays = (self.replays - replays_before) as f64;
            self.figures.rate_hz = samples / elapsed_s;
            self.figures.replays = if samples > 0.0 { replays / samples } else { 0.0 };
            self.last = (Instant::now(), received, self.replays);
        }
        let steps = self.steps_in_contact;
        let [avg_error, zero_avg_error] =
            self.errors.map(|sum| (steps > 0).then(|| sum / steps as f64));
        SessionFigures {
            seconds: self.started.elapsed().as_secs_f64(),
            received,
            latency_ms: spread(&self.latencies_ms),
            step_ms: spread(&self.steps_ms),
            avg_error,
            zero_avg_error,
            ..self.figures.clone()
        }
    }
}

fn keep(times_ms: &mut VecDeque<f64>, time: Duration) {
    if times_ms.len() == WINDOW {
        times_ms.pop_front();
    }
    times_ms.push_back(time.as_secs_f64() * 1e3);
}

fn spread(times_ms: &VecDeque<f64>) -> MedianAndP99 {
    let mut sorted: Vec<f64> = times_ms.iter().copied().collect();
    sorted.sort_by(f64::total_cmp);
    let at = |part: f64| sorted.get((part * sorted.len() as f64) as usize).copied();
    MedianAndP99 { median: at(0.5).unwrap_or_default(), p99: at(0.99).unwrap_or_default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DVector, dvector};

    #[test]
    fn spreads_are_of_the_latest_steps() {
        let mut tally = SessionCounters::default();
        let mut step = |took| tally.step(&StepOutcome::default(), took);
        (0..100).for_each(|_| step(Duration::from_secs(1)));
        (0..WINDOW).for_each(|ms| step(Duration::from_millis(ms as u64)));
        let figures = tally.figures(0);
        let wanted = MedianAndP99 { median: 0.5 * WINDOW as f64, p99: 0.99 * WINDOW as f64 };
        assert_eq!((figures.step_ms, figures.mapped), (wanted, 100 + WINDOW as u64));
    }

    #[test]
    fn errors_in_contact_are_given_with_those_of_predicting_zero() {
        let mut tally = SessionCounters::default();
        assert_eq!(tally.figures(0).avg_error, None);
        let mut step = |contacts, external: DVector<f64>, predicted| {
            let torques = Some((external, predicted));
            tally
                .step(&StepOutcome { torques, contacts, ..StepOutcome::default() }, Duration::ZERO);
        };
        step(1, dvector![3.0, 4.0], dvector![3.0, 0.0]);
        step(2, dvector![0.0, 1.0], dvector![0.0, 1.0]);
        step(0, dvector![0.0, 5.0], dvector![0.0, 0.0]);
        let figures = tally.figures(0);
        assert_eq!((figures.avg_error, figures.zero_avg_error), (Some(2.0), Some(3.0)));
        assert_eq!((figures.external_n_m, figures.contacts), (Some(5.0), 0));
    }

    #[test]
    fn the_first_message_refused_for_a_reason_is_distinguished_from_the_others() {
        let mut tally = SessionCounters::default();
        let first = ["a", "a", "b", "a"].map(|reason| tally.refuse(reason));
        assert_eq!(first, [true, false, true, false]);
        assert_eq!(tally.figures(0).refused, BTreeMap::from([("a", 3), ("b", 1)]));
    }
}
