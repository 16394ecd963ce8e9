//! Splits a continuous stream of samples into touches, where the arm pauses.
//!
//! An arm that stands still without contact is between two touches, and its torques then give the
//! tare of the next touch. So a new touch begins once the arm has stood still for long enough, and
//! the samples of this pause are its first ones: otherwise a touch in which the arm moves at once
//! would have no tare. Standing still while pushing is no pause, so the caller passes the number of
//! touched points ([`crate::mapper::StepReport::contacts`], or [`crate::contact::Contacts::len`]).
//! An arm that is back at its start may still hold a few points that slipped on the way, so it
//! counts as free below a small share of the largest number of points in the touch.
//!
//! A pause begins one touch. In a long pause, another touch begins from time to time, so that the
//! tare stays recent and the sample log of an idle arm does not grow.
//!
//! The only clock is that of the samples. The module depends neither on robot nor on contacts.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use crate::setting::SettingError;
use crate::tare::MIN_TARE_FRAMES;
use crate::tracker::Sample;

/// What counts as a pause.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct PauseConfig {
    /// The arm counts as standing still while no joint is farther than this from its position at
    /// the start of the pause, in a longer pause `idle_s` ago, rad (m for a prismatic joint).
    pub still_rad: f64,
    /// Duration of standing still that makes a pause, s, by the clock of the samples.
    pub idle_s: f64,
    /// Number of still samples that make a pause, if samples have no time.
    pub idle_samples: u32,
    /// In a pause, time since the start of a touch after which a new touch begins, s.
    pub renew_s: f64,
    /// In a pause, number of samples since the start of a touch after which a new touch begins, if
    /// samples have no time.
    pub renew_samples: u32,
}

impl Default for PauseConfig {
    fn default() -> Self {
        Self { still_rad: 0.002, idle_s: 0.5, idle_samples: 25, renew_s: 30.0, renew_samples: 1500 }
    }
}

/// Largest number of samples that are kept of a pause. As many still samples are a pause, whatever
/// their times are.
const MAX_HELD: usize = 10_000;

/// The arm counts as free if at most 1/50 of the touch's largest number of contacts is left.
const RESIDUE: usize = 50;

impl PauseConfig {
    /// Checks every setting.
    ///
    /// # Errors
    ///
    /// Names the first setting that is out of its range.
    pub fn check(&self) -> Result<(), SettingError> {
        let check = SettingError::check;
        let samples = f64::from(MIN_TARE_FRAMES)..=MAX_HELD as f64;
        let (idle, renew) = (f64::from(self.idle_samples), f64::from(self.renew_samples));
        check("still_rad", self.still_rad, 0.0..=f64::MAX, "zero or more, and finite")?;
        check("idle_s", self.idle_s, 1e-3..=3600.0, "from 0.001 to 3600 s")?;
        check("idle_samples", idle, samples, "from 5 (the least for a tare) to 10000")?;
        check("renew_s", self.renew_s, self.idle_s..=f64::MAX, "at least idle_s, and finite")?;
        check("renew_samples", renew, idle..=f64::MAX, "at least idle_samples")
    }
}

/// Decides for each sample whether a new touch begins.
///
/// # Example
///
/// ```
/// use palpate::Sample;
/// use palpate::unstable::{PauseConfig, PauseDetector};
///
/// let mut split = PauseDetector::new(PauseConfig::default()).unwrap();
/// let at = |time_s, q| Sample::new(Some(time_s), vec![q], vec![0.0]);
/// // The arm moves, and stands still without contact from 0.1 s on.
/// assert_eq!(split.push(&at(0.0, 0.3), 0), None);
/// let begins = (1..8).find_map(|i| split.push(&at(0.1 * f64::from(i), 0.0), 0));
/// let tare = begins.unwrap();
/// assert_eq!((tare[0].time_s, tare.len()), (Some(0.1), 6));
/// ```
#[derive(Debug, Clone)]
pub struct PauseDetector {
    config: PauseConfig,
    /// The latest still samples, no more than make a pause; positions are compared with the first.
    still: VecDeque<Sample>,
    /// Whether this pause has not begun a touch yet.
    due: bool,
    /// Time of the first sample since a touch began.
    begun_s: Option<f64>,
    /// Number of samples since a touch began, and the largest number of points touched in it.
    since: u64,
    most_contacts: usize,
}

impl PauseDetector {
    /// A detector before the first sample: the first pause begins a touch.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range.
    pub fn new(config: PauseConfig) -> Result<Self, SettingError> {
        config.check()?;
        Ok(Self {
            config,
            still: VecDeque::new(),
            due: true,
            begun_s: None,
            since: 0,
            most_contacts: 0,
        })
    }

    /// Notes that the caller begins a touch with the next sample.
    pub fn begun(&mut self) {
        self.still.clear();
        (self.due, self.begun_s, self.since, self.most_contacts) = (false, None, 0, 0);
    }

    /// Takes the next sample, and the number of points that the arm touches there.
    ///
    /// Returns `None` if the touch under way goes on, else the first samples of a new touch, oldest
    /// first; the last of them is `sample`. The caller passes all of them to the new touch, even
    /// those already passed to the touch before: they are without contact, so nothing is learnt
    /// twice. They are at most 10,000, at least [`MIN_TARE_FRAMES`].
    pub fn push(&mut self, sample: &Sample, contacts: usize) -> Option<Vec<Sample>> {
        self.since += 1;
        self.begun_s = self.begun_s.or(sample.time_s);
        self.most_contacts = self.most_contacts.max(contacts);
        if contacts * RESIDUE > self.most_contacts {
            self.still.clear();
            self.due = true;
            return None;
        }
        match self.still.front() {
            Some(first) if !self.stands_still(first, sample) => {
                self.still.clear();
                self.due = true;
            }
            // After the clock was set back, the duration of the pause is unknown: it starts anew.
            Some(first) if elapsed_s(first, sample).is_some_and(|elapsed_s| elapsed_s < 0.0) => {
                self.still.clear();
                self.begun_s = sample.time_s;
            }
            _ => {}
        }
        self.still.push_back(sample.clone());
        while self.still.len() > 1 && self.is_pause(1) {
            self.still.pop_front();
        }
        if !(self.is_pause(0) && (self.due || self.is_stale(sample))) {
            return None;
        }
        (self.due, self.begun_s, self.since, self.most_contacts) = (false, sample.time_s, 0, 0);
        Some(self.still.iter().cloned().collect())
    }

    /// Number of samples that would be returned if a touch began now. A caller without real-time
    /// needs can hold them back, so that each sample is in one touch only.
    pub fn held(&self) -> usize {
        self.still.len()
    }

    /// Whether no joint has left its position at the start of the pause. A continuous joint may be
    /// logged a whole turn further on.
    fn stands_still(&self, first: &Sample, now: &Sample) -> bool {
        let near = |way: f64| way.min((way - TAU).abs()) <= self.config.still_rad;
        first.q.len() == now.q.len()
            && first.q.iter().zip(&now.q).all(|(first, now)| near((now - first).abs()))
    }

    /// Whether the still samples are a pause, without the first ones (as many as `without`).
    fn is_pause(&self, without: usize) -> bool {
        let samples = self.still.len() - without;
        if samples < MIN_TARE_FRAMES as usize {
            return false;
        }
        let elapsed_s = match (self.still.get(without), self.still.back()) {
            (Some(first), Some(last)) => elapsed_s(first, last),
            _ => None,
        };
        let long = match elapsed_s {
            // With a tolerance for rounding, since times are decimal fractions.
            Some(elapsed_s) => elapsed_s >= self.config.idle_s * (1.0 - 1e-9),
            None => samples >= self.config.idle_samples as usize,
        };
        long || samples >= MAX_HELD
    }

    /// Whether the touch began so long ago that it needs a new tare.
    fn is_stale(&self, now: &Sample) -> bool {
        match (self.begun_s, now.time_s) {
            (Some(begun_s), Some(now_s)) => now_s - begun_s >= self.config.renew_s,
            _ => self.since >= u64::from(self.config.renew_samples),
        }
    }
}

/// Time between two samples, s, if both have it.
fn elapsed_s(from: &Sample, to: &Sample) -> Option<f64> {
    Some(to.time_s? - from.time_s?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const PERIOD_S: f64 = 0.02;

    fn sample(i: usize, q: f64) -> Sample {
        Sample::new(Some(i as f64 * PERIOD_S), vec![0.5, q], vec![0.0; 2])
    }

    /// A detector, and the numbers of the first samples of each touch that it began.
    struct Run {
        split: PauseDetector,
        at: usize,
        clock: bool,
        begins: Vec<Vec<f64>>,
    }

    impl Run {
        fn new(clock: bool) -> Self {
            let split = PauseDetector::new(PauseConfig::default()).unwrap();
            Self { split, at: 0, clock, begins: Vec::new() }
        }

        fn push(&mut self, q: f64, touching: bool) {
            let mut sample = sample(self.at, q);
            sample.tau[0] = self.at as f64;
            sample.time_s = sample.time_s.filter(|_| self.clock);
            let begins = self.split.push(&sample, if touching { 100 } else { 0 });
            self.begins.extend(begins.map(|samples| samples.iter().map(|s| s.tau[0]).collect()));
            self.at += 1;
        }

        fn still(&mut self, samples: usize, q: f64, touching: bool) -> &mut Self {
            (0..samples).for_each(|_| self.push(q, touching));
            self
        }

        fn moving(&mut self, samples: usize, touching: bool) -> &mut Self {
            (0..samples).for_each(|i| self.push(1.0 + 0.01 * i as f64, touching));
            self
        }
    }

    #[test]
    fn a_touch_begins_once_the_arm_has_idled_and_owns_the_still_samples() {
        for (clock, needed) in [(true, 26), (false, 25)] {
            let mut run = Run::new(clock);
            run.moving(10, false).still(needed - 1, 0.0, false);
            assert!(run.begins.is_empty());
            run.still(1, 0.0, false);
            let expected: Vec<f64> = (10..10 + needed).map(|i| i as f64).collect();
            assert_eq!(run.begins, [expected]);
        }
    }

    #[test]
    fn a_pause_begins_one_touch_and_the_next_comes_after_motion_or_contact() {
        for clock in [true, false] {
            let mut run = Run::new(clock);
            run.still(1000, 0.0, false);
            assert_eq!(run.begins.len(), 1);
            run.moving(50, false).still(100, 0.0, false);
            assert_eq!(run.begins.len(), 2);
            run.still(3, 0.0, true).still(100, 0.0, false);
            assert_eq!(run.begins.len(), 3);
            assert_eq!(run.begins[2][0], 1153.0);
        }
    }

    #[test]
    fn holding_still_while_pushing_is_no_pause() {
        let mut run = Run::new(true);
        run.moving(10, false).still(10_000, 0.0, true);
        assert!(run.begins.is_empty());
        assert_eq!(run.split.held(), 0);
    }

    #[test]
    fn a_few_contacts_left_of_many_do_not_prevent_a_pause() {
        for (left, begins) in [(0, true), (2, true), (3, false), (100, false)] {
            let mut split = PauseDetector::new(PauseConfig::default()).unwrap();
            split.begun();
            assert_eq!(split.push(&sample(0, 1.0), 100), None);
            let began = (1..100).any(|i| split.push(&sample(i, 0.0), left).is_some());
            assert_eq!(began, begins, "{left}");
        }
    }

    #[test]
    fn a_long_pause_is_renewed_with_its_latest_samples_only() {
        for (clock, renewals) in [(true, [25, 1525, 3025]), (false, [24, 1524, 3024])] {
            let mut run = Run::new(clock);
            run.still(3100, 0.0, false);
            let last: Vec<f64> = run.begins.iter().map(|touch| *touch.last().unwrap()).collect();
            assert_eq!(last, renewals.map(f64::from));
            assert!(run.begins.iter().all(|touch| touch.len() <= 26));
        }
    }

    #[test]
    fn a_touch_begun_by_the_caller_is_not_begun_again_by_the_same_pause() {
        let mut run = Run::new(true);
        run.split.begun();
        run.still(200, 0.0, false);
        assert!(run.begins.is_empty());
        run.moving(5, false).still(100, 0.0, false);
        assert_eq!(run.begins.len(), 1);
    }

    #[test]
    fn a_clock_set_back_starts_the_pause_anew_and_a_gap_alone_is_none() {
        let mut split = PauseDetector::new(PauseConfig::default()).unwrap();
        for i in (100..120).chain(0..25) {
            assert_eq!(split.push(&sample(i, 0.0), 0), None, "{i}");
        }
        assert_eq!(split.push(&sample(25, 0.0), 0).map(|touch| touch.len()), Some(26));

        let mut split = PauseDetector::new(PauseConfig::default()).unwrap();
        for i in [0, 1000, 2000, 3000] {
            assert_eq!(split.push(&sample(i, 0.0), 0), None, "too few for a tare");
        }
    }

    #[test]
    fn a_joint_that_wraps_by_a_whole_turn_stands_still_one_that_moves_2_mrad_does_not() {
        let mut run = Run::new(true);
        for i in 0..30 {
            let almost = std::f64::consts::PI - 5e-4;
            run.push(if i % 2 == 0 { almost } else { -almost }, false);
        }
        assert_eq!(run.begins.len(), 1);
        let mut run = Run::new(true);
        for i in 0..300 {
            run.push(0.0021 * f64::from(i % 2), false);
        }
        assert!(run.begins.is_empty());
    }

    #[test]
    fn samples_held_are_bounded_even_if_the_clock_stops() {
        let mut split = PauseDetector::new(PauseConfig::default()).unwrap();
        for _ in 0..3 * MAX_HELD {
            split.push(&sample(0, 0.0), 0);
            assert!(split.held() <= MAX_HELD);
        }
    }

    #[test]
    fn settings_out_of_range_are_named() {
        let good = PauseConfig::default();
        for (bad, named) in [
            (PauseConfig { still_rad: f64::NAN, ..good.clone() }, "still_rad"),
            (PauseConfig { idle_s: 0.0, ..good.clone() }, "idle_s"),
            (PauseConfig { idle_samples: 4, ..good.clone() }, "idle_samples"),
            (PauseConfig { renew_s: 0.1, ..good.clone() }, "renew_s"),
            (PauseConfig { renew_samples: 1, ..good }, "renew_samples"),
        ] {
            assert_eq!(PauseDetector::new(bad).unwrap_err().setting, named);
        }
    }

    proptest! {
        #[test]
        fn no_touch_begins_while_anything_is_touched_or_moves(
            moments in proptest::collection::vec((0_u8..3, 0.0..0.001_f64, 1_usize..60), 0..40),
        ) {
            let mut run = Run::new(true);
            for (kind, q, samples) in moments {
                let before = run.begins.len();
                match kind {
                    0 => { run.still(samples, q, false); }
                    1 => { run.still(samples, q, true); }
                    _ => { run.moving(samples, false); }
                }
                prop_assert!(kind == 0 || run.begins.len() == before);
                for touch in &run.begins[before..] {
                    prop_assert!(touch.len() >= MIN_TARE_FRAMES as usize);
                    prop_assert!(touch.array_windows().all(|[a, b]| b - a == 1.0), "in a row");
                }
            }
        }
    }
}
