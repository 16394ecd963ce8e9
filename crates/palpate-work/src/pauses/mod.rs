//! `--split-idle`: splits a log into touches where the arm pauses without contact.
//!
//! [`PauseDetector`] finds the pauses. The number of contacts that it needs comes from a simulation of its own, with
//! the arm, the workspace box and the default contact model, so that all commands split a log alike, whatever contact
//! distance they choose; it counts as zero if the torques show that the arm carries no load (`load`). Samples at rest
//! are held back until it is known to which touch they belong, so that each is in one touch only. A touch of the log
//! may be split into several, but is never joined with another. Samples of a motion before the first standstill have
//! no tare and are left out, with a warning.

mod load;

use std::collections::VecDeque;
use std::sync::Arc;

use palpate::unstable::{PauseConfig, PauseDetector, Tracker};
use palpate::{
    Arm, ContactConfig, ExternalTorqueConfig, Gravity, Lattice, MIN_TARE_FRAMES, MapperError,
    Sample, Tare,
};

use crate::settings::SettingsError;
use crate::touches::TouchEvent;
use load::Load;

/// Splits touches at pauses.
pub(crate) struct Pauses {
    tracker: Tracker,
    split: PauseDetector,
    load: Load,
    still_rad: f64,
    /// Name of the touch in the log, and into how many parts it has been split so far.
    name: String,
    parts: u32,
    /// Samples that are held back until their touch is known.
    queue: VecDeque<Sample>,
    /// Number of samples that were left out before the first standstill.
    left_out: u64,
}

impl Pauses {
    /// For touches of an arm, with contacts in a lattice.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range.
    pub(crate) fn new(
        arm: &Arc<Arm>,
        lattice: Lattice,
        config: PauseConfig,
    ) -> Result<Self, SettingsError> {
        let still_rad = config.still_rad;
        let split = PauseDetector::new(config).map_err(SettingsError::value)?;
        // Only contacts are needed: nothing is subtracted from the torques, so that no tare can be missing.
        let mut touch = ExternalTorqueConfig::default();
        (touch.gravity, touch.tare) = (Gravity::Removed, Tare::None);
        let tracker = Tracker::new(Arc::clone(arm), lattice, &ContactConfig::default(), touch)
            .map_err(SettingsError::value)?;
        let (name, queue, load) = (String::new(), VecDeque::new(), Load::default());
        Ok(Self { tracker, split, load, still_rad, name, parts: 0, queue, left_out: 0 })
    }

    /// Takes the next event of the log, and appends the events that result to `then`.
    ///
    /// # Errors
    ///
    /// If a sample does not fit the arm.
    pub(crate) fn take(
        &mut self,
        event: TouchEvent,
        then: &mut VecDeque<TouchEvent>,
    ) -> Result<(), MapperError> {
        match event {
            TouchEvent::Touch(name) => {
                self.finish(then);
                (self.name, self.parts) = (name, 0);
                self.tracker.begin_touch();
                self.split.begun();
                self.load.clear();
            }
            TouchEvent::Sample(sample) => self.take_sample(sample, then)?,
        }
        Ok(())
    }

    /// Hands on the samples that were held back, at the end of a touch or of the log.
    pub(crate) fn finish(&mut self, then: &mut VecDeque<TouchEvent>) {
        if self.parts == 0 && !self.queue.is_empty() {
            self.announce(then);
        }
        then.extend(self.queue.drain(..).map(TouchEvent::Sample));
    }

    /// Number of samples that were left out because the arm had not stood still before them.
    pub(crate) fn left_out(&self) -> u64 {
        self.left_out
    }

    fn take_sample(
        &mut self,
        sample: Sample,
        then: &mut VecDeque<TouchEvent>,
    ) -> Result<(), MapperError> {
        let contacts = self.tracker.feed(&sample)?.contacts.len();
        let is_free = self.load.is_free(&self.tracker.arm().robot, &sample, self.still_rad);
        let contacts = if is_free { 0 } else { contacts };
        let begins = self.split.push(&sample, contacts);
        self.queue.push_back(sample);
        if let Some(still) = begins {
            self.release(still.len(), then);
            self.announce(then);
            self.load.begin();
            // Points that the arm covers in the pause are empty space for the next touch.
            self.tracker.begin_touch();
            if let Some(sample) = self.queue.back() {
                self.tracker.feed(sample)?;
            }
        } else if self.queue.len() > self.split.held() {
            if self.parts == 0 && self.queue.len() > MIN_TARE_FRAMES as usize {
                self.announce(then);
            }
            self.release(self.split.held(), then);
        }
        Ok(())
    }

    /// Hands on all held samples but the latest `kept`; before the first touch they are left out.
    fn release(&mut self, kept: usize, then: &mut VecDeque<TouchEvent>) {
        let over = self.queue.len().saturating_sub(kept);
        let released = self.queue.drain(..over);
        if self.parts == 0 {
            self.left_out += released.len() as u64;
        } else {
            then.extend(released.map(TouchEvent::Sample));
        }
    }

    fn announce(&mut self, then: &mut VecDeque<TouchEvent>) {
        self.parts += 1;
        let name = match self.parts {
            1 => self.name.clone(),
            parts => format!("{}_{parts}", self.name),
        };
        then.push_back(TouchEvent::Touch(name));
    }
}
