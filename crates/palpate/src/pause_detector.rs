//! Touches split by idleness: where a stream of samples without marks pauses between two touches.
//!
//! An arm that stands still and touches nothing is between touches, and what its sensors say then
//! is the tare of the touch to come. So a new touch begins once the arm has idled for long enough,
//! and the still samples of that pause are its first: without them, an arm that moves on at once
//! would leave the new touch without a tare. Standing still while pushing is no pause, which is
//! why the caller says how many points are touched ([`crate::mapper::StepReport::contacts`], or
//! [`crate::contact::Contacts::len`]). An arm that comes back to where it started still drags a few
//! points that slipped on the way, so what counts as nothing is a small part of the most that the
//! touch has held.
//!
//! A pause begins one touch, however long it lasts, but is renewed now and then: the tare stays
//! fresh, and the sample log of an arm that idles through the night does not grow.
//!
//! The module reads the samples' clock and no other; it knows no robot and no contact.

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
    /// The farthest a joint may be from where the pause began and still stand still, rad (m for a
    /// prismatic joint).
    pub still_rad: f64,
    /// How long the arm must stand still, s, by the clock of the samples.
    pub idle_s: f64,
    /// The same in samples, where they carry no time.
    pub idle_samples: u32,
    /// An arm that idles for so long since a touch began gets a new one, s.
    pub renew_s: f64,
    /// The same in samples, where they carry no time.
    pub renew_samples: u32,
}

impl Default for PauseConfig {
    fn default() -> Self {
        Self { still_rad: 0.002, idle_s: 0.5, idle_samples: 25, renew_s: 30.0, renew_samples: 1500 }
    }
}

/// So many samples of a pause are kept at most, and so many are a pause whatever their clock says.
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
        let samples = [f64::from(MIN_TARE_FRAMES), MAX_HELD as f64];
        let (idle, most) = (f64::from(self.idle_samples), f64::from(u32::MAX));
        for (setting, found, [low, high], wanted) in [
            ("still_rad", self.still_rad, [0.0, f64::MAX], "zero or more, and finite"),
            ("idle_s", self.idle_s, [1e-3, 3600.0], "from 0.001 to 3600 s"),
            ("idle_samples", idle, samples, "from 5, which a tare needs, to 10000"),
            ("renew_s", self.renew_s, [self.idle_s, f64::MAX], "at least idle_s, and finite"),
            ("renew_samples", self.renew_samples.into(), [idle, most], "at least idle_samples"),
        ] {
            if !(low..=high).contains(&found) {
                return Err(SettingError::new(setting, found, wanted));
            }
        }
        Ok(())
    }
}

/// Says of one sample after the other whether a new touch begins with it.
///
/// # Example
///
/// ```
/// use palpate::Sample;
/// use palpate::unstable::{PauseConfig, PauseDetector};
///
/// let mut split = PauseDetector::new(PauseConfig::default()).unwrap();
/// let at = |time_s, q| Sample::new(Some(time_s), vec![q], vec![0.0]);
/// // It moves, and stands still from 0.1 s on, in the air.
/// assert_eq!(split.push(&at(0.0, 0.3), 0), None);
/// let begins = (1..8).find_map(|i| split.push(&at(0.1 * f64::from(i), 0.0), 0));
/// let tare = begins.unwrap();
/// assert_eq!((tare[0].time_s, tare.len()), (Some(0.1), 6));
/// ```
#[derive(Debug, Clone)]
pub struct PauseDetector {
    config: PauseConfig,
    /// The latest samples that stand still, the first of them where the pause began.
    still: VecDeque<Sample>,
    /// Whether this pause has not begun a touch yet.
    due: bool,
    /// Time of the first sample since a touch began.
    begun_s: Option<f64>,
    /// Samples since a touch began, and the most points that it has touched.
    since: u64,
    most_contacts: usize,
}

impl PauseDetector {
    /// Before the first sample, with no touch begun: the first pause begins one.
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

    /// Takes note that the caller begins a touch of its own accord, with the next sample.
    pub fn begun(&mut self) {
        self.still.clear();
        (self.due, self.begun_s, self.since, self.most_contacts) = (false, None, 0, 0);
    }

    /// Takes the next sample, and how many points the arm touches at it.
    ///
    /// `None`: the touch under way goes on. `Some`: a new touch begins with these samples, oldest
    /// first, the last of which is the one just given. The others were given before; whoever has
    /// fed them to the touch before feeds them to the new one again, which teaches nothing twice,
    /// since nothing is touched at them. At most 10,000, at least [`MIN_TARE_FRAMES`].
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
            // A clock that was set back says nothing about how long the pause has lasted.
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

    /// How many of the latest samples stand still and would come back if a touch began now: a
    /// reader that need not be quick holds so many back, and each is in one touch only.
    pub fn held(&self) -> usize {
        self.still.len()
    }

    /// Whether no joint has left the place where the pause began. A joint that turns without end
    /// may be logged a whole turn further on.
    fn stands_still(&self, first: &Sample, now: &Sample) -> bool {
        let near = |way: f64| way.min((way - TAU).abs()) <= self.config.still_rad;
        first.q.len() == now.q.len()
            && first.q.iter().zip(&now.q).all(|(first, now)| near((now - first).abs()))
    }

    /// Whether the still samples without the first so many are a pause.
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
            // A hair less is as good: stamps are decimal fractions.
            Some(elapsed_s) => elapsed_s >= self.config.idle_s * (1.0 - 1e-9),
            None => samples >= self.config.idle_samples as usize,
        };
        long || samples >= MAX_HELD
    }

    /// Whether the touch began too long ago for its tare to be fresh.
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

    /// A split, and which samples (by number) each touch of a motion starts with.
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
