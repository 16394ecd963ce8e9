//! Learning logged touches again: without some of them, or with other settings.
//!
//! A mapper keeps the samples of the touches that it remembers, and learning takes a thousandth of the time of
//! touching. So touches are forgotten by learning all others again, in their order: stiffness, standard deviations,
//! counts and memory are equal to the bit to those of a mapper that never learnt the forgotten touches.
//! [`crate::unstable::MapEstimator::forget`] removes single remembered frames, but neither their effect on standard
//! deviations nor condensed frames.
//!
//! Another mapper with other settings learns beside a mapper that goes on ([`Mapper::catch_up`]), and then takes its
//! place.

use std::cmp::Ordering;
use std::collections::HashSet;
use std::sync::Arc;

use super::{LoggedTouch, Mapper, MapperError, Snapshot};
use crate::arm::Arm;

/// What a mapper has logged, from some touch on.
#[derive(Debug, Clone, Default)]
pub struct TouchLog {
    /// The touches that it remembers, and the one under way.
    pub touches: Vec<LoggedTouch>,
    /// Number of touches begun so far.
    begun: u32,
    /// Time of the last learnt sample of the touch under way, s.
    learnt_s: Option<f64>,
}

/// How far a mapper has learnt; by default, nothing.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LogPosition {
    /// Number of touches begun.
    begun: u32,
    /// Number of samples of the last one, if it is still under way.
    samples: Option<u32>,
}

impl TouchLog {
    /// The end of its last completed touch.
    pub fn end(&self) -> LogPosition {
        let under_way = self.touches.last().is_some_and(|last| last.open);
        LogPosition { begun: self.begun - u32::from(under_way), samples: None }
    }

    /// Adds the completed touches of a later log.
    pub fn extend(&mut self, later: Self) {
        self.begun = later.end().begun;
        self.touches.extend(later.touches.into_iter().filter(|touch| !touch.open));
    }

    /// Number of its samples beyond a position.
    pub fn n_beyond(&self, position: LogPosition, n_joints: usize) -> usize {
        let samples = |touch: &LoggedTouch| touch.q.len() / n_joints;
        let beyond =
            |touch: &LoggedTouch| Some(samples(touch).saturating_sub(position.within(touch)?));
        self.touches.iter().filter_map(beyond).sum()
    }
}

impl LogPosition {
    /// Number of touches that were begun and are over.
    pub fn completed(self) -> u32 {
        self.begun - u32::from(self.samples.is_some())
    }

    /// Number of samples of a touch before this position; `None` if the touch is over by then.
    fn within(self, touch: &LoggedTouch) -> Option<usize> {
        match (touch.touch + 1).cmp(&self.begun) {
            Ordering::Less => None,
            Ordering::Equal => self.samples.map(|samples| samples as usize),
            Ordering::Greater => Some(0),
        }
    }
}

impl Mapper {
    /// Rebuilds the mapper of a snapshot without some of its touches, given by their numbers
    /// ([`super::LoggedTouch::touch`]).
    ///
    /// The other touches keep their numbers. `goes_on` is called after every sample; when it returns false, rebuilding
    /// stops and `None` is returned.
    ///
    /// # Errors
    ///
    /// If a number is not in the sample log, if the samples of another learnt touch are gone, so that it would be
    /// forgotten as well ([`Snapshot::gone`]), if the arm is not that of the snapshot, or the snapshot is inconsistent.
    pub fn without(
        arm: Arc<Arm>,
        snapshot: &Snapshot,
        touches: &[u32],
        goes_on: impl FnMut() -> bool,
    ) -> Result<Option<Self>, MapperError> {
        snapshot.check_arm(&arm)?;
        let inconsistent = |what: String| MapperError::Snapshot { what };
        let known: HashSet<u32> = snapshot.sample_log.iter().map(|logged| logged.touch).collect();
        if let Some(unknown) = touches.iter().find(|touch| !known.contains(touch)) {
            return Err(inconsistent(format!("touch {unknown} is not in its sample log")));
        }
        if snapshot.gone > 0 {
            return Err(MapperError::Gone { touches: snapshot.gone });
        }
        let means = snapshot.prior_means_n_per_m.iter().copied();
        let prior: Vec<_> = snapshot.cells.iter().copied().zip(means).collect();
        let mut mapper = Self::with_prior(arm, snapshot.config.clone(), &prior)?
            .with_calibration(snapshot.calibration.clone());
        let kept = snapshot.sample_log.iter().filter(|logged| !touches.contains(&logged.touch));
        let log = TouchLog {
            touches: kept.cloned().collect(),
            begun: snapshot.touches,
            learnt_s: snapshot.learnt_s,
        };
        if !mapper.catch_up(&log, goes_on)? {
            return Ok(None);
        }
        mapper.go_on_after(&log);
        Ok(Some(mapper))
    }

    /// What was logged, from a position on: whole touches, the one at the position among them.
    ///
    /// # Errors
    ///
    /// [`MapperError::NotLogged`] if samples of learnt touches are no longer in memory.
    pub fn log_from(&self, position: LogPosition) -> Result<TouchLog, MapperError> {
        let remembered = self.replays.estimator().frame_ids();
        let under_way = self.tracker.is_in_touch();
        let (touches, gone) = self.log.needed_by(&remembered, (position.completed(), under_way));
        if gone > 0 {
            return Err(MapperError::NotLogged { touches: gone });
        }
        let learnt_s = under_way.then(|| self.tracker.learnt_s()).flatten();
        Ok(TouchLog { touches, begun: self.log.begun(), learnt_s })
    }

    /// How far this mapper has learnt.
    pub fn position(&self) -> LogPosition {
        let samples = self.tracker.is_in_touch().then(|| self.log.samples());
        LogPosition { begun: self.log.begun(), samples }
    }

    /// Learns what another mapper has logged beyond [`Mapper::position`], as if the samples had come now: with the same
    /// settings, the result is the other mapper, to the bit, up to replays in spare time. `goes_on` is called after
    /// every sample; when it returns false, learning stops and false is returned.
    ///
    /// # Errors
    ///
    /// If a sample cannot be used with these settings. What was learnt until then stays.
    pub fn catch_up(
        &mut self,
        log: &TouchLog,
        mut goes_on: impl FnMut() -> bool,
    ) -> Result<bool, MapperError> {
        let n_joints = self.tracker.arm().robot.n_joints();
        for logged in &log.touches {
            let Some(done) = self.position().within(logged) else { continue };
            if logged.touch + 1 != self.log.begun() {
                self.end_if_under_way();
                self.log.number_next(logged.touch);
                self.begin_touch();
                self.name_touch(&logged.name);
            }
            for sample in logged.samples(n_joints).skip(done) {
                self.step(&sample)?;
                if !goes_on() {
                    return Ok(false);
                }
            }
            if !logged.open {
                self.end_touch()?;
            }
        }
        if !log.touches.last().is_some_and(|last| last.open) {
            self.end_if_under_way();
        }
        Ok(true)
    }

    /// Goes on after the last sample of a log that this mapper has caught up with: with the clock of the log and the
    /// number of its touches.
    pub fn go_on_after(&mut self, log: &TouchLog) {
        if log.touches.last().is_some_and(|last| last.open) {
            self.tracker.set_learnt_s(log.learnt_s);
        }
        self.log.number_next(log.begun);
    }

    fn end_if_under_way(&mut self) {
        if self.tracker.is_in_touch() {
            // An error means that the touch was too short for its tare: then nothing was learnt from it.
            let _ = self.end_touch();
        }
    }
}
