//! The step in two parts, on one thread: the simulator, and the update with its replays.
//!
//! This is `Mapper::step` taken apart, and the only file of the command that knows how the core
//! composes a step. The *simulator* is [`Tracker::feed`]: kinematics, gravity, sub-steps and
//! contacts. The *update* is all the rest: the frame folded into an observation, the
//! prediction, the correction, and the visits of remembered frames.
//!
//! No sample log is kept, as it takes no part in the times.

use std::sync::Arc;
use std::time::{Duration, Instant};

use palpate::unstable::{CellRows, Estimator, FrameId, ObservationBuilder, TrackedSample, Tracker};
use palpate::{Arm, MapperConfig, MapperError, Sample};
use palpate_work::touches::RecordedTouch;

use super::recording::{Learner, Passes, milliseconds, play};
use crate::error::CliError;
use crate::output::Output;
use crate::settings::SettingsError;

/// What a mapper is made of, under the clock.
pub(super) struct Parts {
    tracker: Tracker,
    observations: ObservationBuilder,
    estimator: Box<dyn Estimator>,
    replays: u32,
    next: FrameId,
    /// What was measured.
    times: Times,
}

/// The timed steps.
#[derive(Debug, Clone, Default)]
pub(super) struct Times {
    /// The simulator's share of each, ms.
    pub simulator_ms: Vec<f64>,
    /// The update's share of each, ms.
    pub update_ms: Vec<f64>,
    /// The replays of each, by contact visited, ns.
    pub visit_ns: Vec<f64>,
    /// The whole update of each, by contact visited, ns.
    pub update_ns: Vec<f64>,
}

/// Learns all passes on one thread.
pub(super) fn measure(
    arm: &Arc<Arm>,
    config: &MapperConfig,
    touches: &[RecordedTouch],
    passes: Passes,
    output: &Output,
) -> Result<Times, CliError> {
    let out_of_range = |error| SettingsError::Value(Box::new(error));
    let mut parts = Parts::new(arm, config).map_err(out_of_range)?;
    play(touches, passes, &mut parts, output, "timing its parts")?;
    Ok(parts.times)
}

impl Parts {
    fn new(arm: &Arc<Arm>, config: &MapperConfig) -> Result<Self, MapperError> {
        let estimator = config.estimator(arm.robot.n_joints())?;
        let (contact, touch) = (config.contact.clone(), config.touch.clone());
        let tracker = Tracker::new(Arc::clone(arm), config.lattice.clone(), &contact, touch)?;
        Ok(Self {
            tracker,
            observations: ObservationBuilder::new(CellRows::new(config.lattice.clone())),
            estimator,
            replays: config.estimator.replays,
            next: FrameId { touch: 0, sample: 0 },
            times: Times::default(),
        })
    }

    /// Folds a frame, predicts and corrects; says whether it learnt from it.
    fn correct(&mut self, frame: &TrackedSample, source: FrameId) -> Result<bool, MapperError> {
        let Some(external) = &frame.external else { return Ok(false) };
        if frame.contacts.is_empty() {
            self.estimator.advance_time();
            return Ok(false);
        }
        let (robot, contacts) = (&self.tracker.arm().robot, &frame.contacts);
        let observation = self.observations.build(robot, &frame.poses, contacts, external);
        self.estimator.correct(self.observations.rows().points_m(), observation, source)?;
        Ok(true)
    }
}

impl Learner for Parts {
    fn begin_touch(&mut self) {
        self.tracker.begin_touch();
        self.next = FrameId { touch: self.next.touch + 1, sample: 0 };
    }

    fn step(&mut self, sample: &Sample, timed: bool) -> Result<(), MapperError> {
        let start = Instant::now();
        let frame = self.tracker.feed(sample)?;
        let simulated = Instant::now();
        let source = self.next;
        self.next.sample += 1;
        if !self.correct(&frame, source)? {
            return Ok(());
        }
        let corrected = Instant::now();
        let replayed = self.estimator.replay(self.replays);
        let updated = Instant::now();
        if timed {
            let times = &mut self.times;
            let update = updated - simulated;
            times.simulator_ms.push(milliseconds(simulated - start));
            times.update_ms.push(milliseconds(update));
            let contacts = frame.contacts.len() as f64 + replayed.contacts as f64;
            times.update_ns.push(nanoseconds(update) / contacts);
            if replayed.contacts > 0 {
                let replays = updated - corrected;
                times.visit_ns.push(nanoseconds(replays) / replayed.contacts as f64);
            }
        }
        Ok(())
    }

    fn end_touch(&mut self) -> Result<(), MapperError> {
        Ok(self.tracker.end_touch()?)
    }
}

fn nanoseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e9
}
