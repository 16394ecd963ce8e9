//! `--split-idle`: a log parted into touches where the arm pauses in the air.
//!
//! [`PauseDetector`] says when; whether anything is touched, a simulator of our own says, which knows
//! the arm and the workspace box, unless the torques show that the arm bears nothing (`load`). Still
//! samples are held back until it is known which touch they belong to, so that each is in one touch
//! only. What a log calls a touch stays one, and may become several; samples of an arm that moves
//! before it has stood still once have no tare and are left out, with a warning.

mod load;

use std::collections::VecDeque;
use std::sync::Arc;

use palpate::unstable::{PauseConfig, PauseDetector, Tracker};
use palpate::{
    Arm, ContactConfig, ExternalTorqueConfig, Gravity, Lattice, MIN_TARE_FRAMES, MapperError,
    Sample, Tare,
};

use crate::recorded::TouchEvent;
use crate::settings::SettingsError;
use load::Load;

/// Parts touches at pauses.
pub(crate) struct Pauses {
    tracker: Tracker,
    split: PauseDetector,
    load: Load,
    still_rad: f64,
    /// The touch as the log calls it, and how many it has become.
    name: String,
    parts: u32,
    /// Samples whose touch is not known yet, the last of them held back.
    queue: VecDeque<Sample>,
    /// Samples before the first pause.
    left_out: u64,
}

impl Pauses {
    /// Parts the touches of an arm in a box.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range.
    pub(crate) fn new(
        arm: &Arc<Arm>,
        (lattice, contact): (Lattice, ContactConfig),
        config: PauseConfig,
    ) -> Result<Self, SettingsError> {
        let still_rad = config.still_rad;
        let split = PauseDetector::new(config).map_err(SettingsError::value)?;
        // Torques do not matter: nothing is taken off them, so that nothing can be missing.
        let mut touch = ExternalTorqueConfig::default();
        (touch.gravity, touch.tare) = (Gravity::Removed, Tare::None);
        let tracker = Tracker::new(Arc::clone(arm), lattice, &contact, touch)
            .map_err(SettingsError::value)?;
        let (name, queue, load) = (String::new(), VecDeque::new(), Load::default());
        Ok(Self { tracker, split, load, still_rad, name, parts: 0, queue, left_out: 0 })
    }

    /// Takes what the log says next; `then` gets what is to be done.
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

    /// Hands on what was held back, at the end of a touch or of the log.
    pub(crate) fn finish(&mut self, then: &mut VecDeque<TouchEvent>) {
        if self.parts == 0 && !self.queue.is_empty() {
            self.announce(then);
        }
        then.extend(self.queue.drain(..).map(TouchEvent::Sample));
    }

    /// Samples that were left out since the arm had not stood still before them.
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
            // What the arm covers in the air is empty space for the touch to come.
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

    /// Hands on all but the latest so many.
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
