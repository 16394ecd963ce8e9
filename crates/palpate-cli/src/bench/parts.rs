//! The step in two parts, on one thread: the simulator, and the update with its replays.
//!
//! This is `Mapper::step` taken apart, and the only file of the command that depends on how the
//! core composes a step. The *simulator* is [`Tracker::feed`]: kinematics, gravity, sub-steps and
//! contacts. The *update* is all the rest: the observation of the frame, the prediction, the
//! correction, and the visits of remembered frames.
//!
//! No sample log is kept, since that is not timed.

use std::sync::Arc;
use std::time::{Duration, Instant};

use palpate::unstable::{CellRows, Estimator, FrameId, ObservationBuilder, TrackedSample, Tracker};
use palpate::{Arm, MapperConfig, MapperError, Sample};
use palpate_work::quantile::median;

use super::Bench;
use super::figures::{Parts, middle};
use super::recording::{Learner, milliseconds, play};
use crate::error::CliError;
use crate::output::Output;
use crate::settings::SettingsError;

/// The parts of a mapper, timed separately.
struct TimedParts {
    tracker: Tracker,
    observations: ObservationBuilder,
    estimator: Box<dyn Estimator>,
    replays: u32,
    next: FrameId,
    /// The measured times.
    times: Times,
}

/// The times of the timed steps.
#[derive(Debug, Clone, Default)]
struct Times {
    /// Time of the simulator in each step, ms.
    simulator_ms: Vec<f64>,
    /// Time of the update in each step, ms.
    update_ms: Vec<f64>,
    /// Time of the replays of each step, divided by the number of contacts visited, ns.
    visit_ns: Vec<f64>,
    /// Time of the update of each step, divided by the number of contacts visited, ns.
    update_ns: Vec<f64>,
}

/// Times the parts of all passes, on one thread.
pub(super) fn measure(bench: &Bench<'_>, output: &Output) -> Result<Parts, CliError> {
    let mut timed = TimedParts::new(&bench.arm, &bench.config).map_err(SettingsError::value)?;
    play(&bench.recording, bench.args.passes, &mut timed, output, "timing the parts")?;
    let times = &timed.times;
    let update_ns_per_visit = middle(&times.update_ns);
    Ok(Parts {
        simulator_ms: middle(&times.simulator_ms),
        update_ms: middle(&times.update_ms),
        ns_per_visit: median(&times.visit_ns).unwrap_or(update_ns_per_visit),
        update_ns_per_visit,
    })
}

impl TimedParts {
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

    /// Makes the observation of a frame, predicts and corrects; returns whether the frame was
    /// learnt.
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

impl Learner for TimedParts {
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
