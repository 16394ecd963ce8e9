//! The mapper beside a running robot, sample by sample, without threads or sockets.
//!
//! A touch begins where the arm pauses and touches nothing ([`PauseDetector`]), or at any pause
//! after somebody says so; until then, nothing is learnt. A sample that cannot be used is left out. If a
//! touch can no longer be followed (it began without a pause, say), it ends, and the next pause begins
//! another: nothing that was learnt is lost. An arm that is suddenly elsewhere, faster than its joints
//! can turn or after a silence, has begun another recording: a touch begins there.
//!
//! Replays are made in spare time: [`Session::spare`] makes one at a time, while no sample waits, and
//! at most those of the settings for each frame.

use nalgebra::DVector;
use palpate::unstable::{PauseConfig, PauseDetector};
use palpate::{
    ExternalTorque, Mapper, MapperError, ReplayPolicy, Sample, SettingError, StepReport, Tare,
    TorqueStream, TrackerError,
};
use serde::{Deserialize, Serialize};

use crate::guard::Guard;

/// So many samples of a pause are enough for the first tare; a pause of a second holds a thousand,
/// and the mapper has other things to do. Those that follow it count as well.
const TARE_SAMPLES: usize = 100;

/// An arm has jumped if a joint went so many times farther than its speed allows, and at least so
/// far, rad or m: logs are played faster than they were recorded.
const TOO_FAST: f64 = 4.0;
const LEAST_JUMP: f64 = 0.2;
/// After a silence of so long, s, it is unknown which way the arm has gone.
const GAP_S: f64 = 1.0;
/// Speed of a joint of which the URDF says none, rad/s or m/s.
const FASTEST: f64 = 3.0;

/// What the session does with the next sample.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// Waits for the arm to pause.
    #[default]
    Waiting,
    /// Takes the tare.
    Taring,
    /// Maps.
    Mapping,
}

/// What came of a sample.
#[derive(Debug, Clone, Default)]
pub struct StepOutcome {
    /// τ_ext and the τ̂ that was predicted before it was learnt from, n_joints, N·m; `None` unless
    /// the session maps.
    pub torques: Option<(DVector<f64>, DVector<f64>)>,
    /// Half-width of the band for largest torques around τ̂, n_joints, N·m, if the mapper reports one ([`Mapper::with_band`]).
    pub peak_half_width: Option<DVector<f64>>,
    /// Points touched.
    pub contacts: usize,
    /// Whether a touch begins with it.
    pub begins: bool,
    /// The samples of the pause that this touch begins with, the last one among them; empty if none begins,
    /// or without a pause.
    pub tare: Vec<Sample>,
    /// How sure τ_ext is, and whether that is a contact, of an arm that was identified.
    pub detection: Option<Detection>,
    /// Why it, or the touch that it belongs to, could not be followed.
    pub fault: Option<String>,
}

/// How sure an external torque is, and what follows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    /// Standard deviation of τ_ext, n_joints, N·m.
    pub std_n_m: Vec<f64>,
    /// Whether something is touched: τ_ext passes the threshold at some joint.
    pub touched: bool,
}

/// A mapper beside a running robot.
pub struct Session {
    mapper: Mapper,
    pauses: PauseDetector,
    /// As it is before the first sample.
    no_pauses: PauseDetector,
    state: State,
    /// The sample before.
    last: Option<Sample>,
    guard: Option<Guard>,
    identified: Option<Identified>,
}

/// An arm that was identified.
struct Identified {
    torques: TorqueStream,
    /// From which on something counts as touched, standard deviations.
    threshold: f64,
    /// Whether external torques are all that is wanted.
    alone: bool,
}

impl Session {
    /// A session of a mapper, whose replays are made in spare time.
    ///
    /// A touch that the mapper was in the middle of has ended: nobody knows what happened since.
    ///
    /// # Errors
    ///
    /// If a setting of the pauses is out of its range.
    pub fn new(
        mapper: Mapper,
        pause_config: PauseConfig,
        guard: Option<Guard>,
    ) -> Result<Self, SettingError> {
        let mut mapper = mapper.with_replays(ReplayPolicy::SpareTime);
        // Too short for its tare, if that: then nothing was learnt from it.
        let _ = mapper.end_touch();
        let no_pauses = PauseDetector::new(pause_config)?;
        let (pauses, state) = (no_pauses.clone(), State::Waiting);
        if let Some(guard) = &guard
            && mapper.config().touch.tare == Tare::None
        {
            let none = DVector::zeros(mapper.arm().robot.n_joints());
            guard.tare(&none).expect("nothing is no load");
        }
        Ok(Self { mapper, pauses, no_pauses, state, last: None, guard, identified: None })
    }

    /// The same session of an arm that was identified: its samples hold external torques with a standard deviation
    /// ([`Session::external`]); something is touched where the torque of a joint is more than `threshold` of them. With
    /// `alone`, nothing is mapped.
    #[must_use]
    pub fn identified(mut self, torques: TorqueStream, threshold: f64, alone: bool) -> Self {
        self.identified = Some(Identified { torques, threshold, alone });
        self
    }

    /// What a sample of the robot is to [`Session::take`]: with its external torque, if the arm was identified.
    ///
    /// # Errors
    ///
    /// If the sample does not fit the robot, or holds a value that is no number.
    pub fn external(&mut self, sample: Sample) -> Result<Sample, TrackerError> {
        let has_jumped = self.has_jumped(&sample);
        let Some(identified) = &mut self.identified else { return Ok(sample) };
        if has_jumped {
            identified.torques.begin();
        }
        identified.torques.external(&sample)
    }

    /// Takes the next sample of the robot.
    pub fn take(&mut self, sample: &Sample) -> StepOutcome {
        let mut outcome = StepOutcome::default();
        if self.identified.as_ref().is_some_and(|identified| identified.alone) {
            (self.state, self.last) = (State::Mapping, Some(sample.clone()));
            let torque = DVector::from_column_slice(&sample.tau);
            let nothing = DVector::zeros(torque.len());
            outcome.torques = Some((torque, nothing));
            outcome.detection = self.detection(&outcome, sample);
            return outcome;
        }
        if self.has_jumped(sample) {
            self.begin(&[], &mut outcome);
            self.pauses.begun();
        }
        self.last = Some(sample.clone());
        if self.state != State::Waiting {
            match self.mapper.step(sample) {
                Ok(report) => self.learnt(report, &mut outcome),
                Err(error) => self.failed(&error, &mut outcome),
            }
        }
        if let Some(tare) = self.pauses.push(sample, outcome.contacts) {
            let every = tare.len().div_ceil(TARE_SAMPLES).max(1);
            let tare: Vec<&Sample> = tare.iter().rev().step_by(every).rev().collect();
            match self.is_loaded(&tare) {
                true => self.wait(), // until the next pause
                false => self.begin(&tare, &mut outcome),
            }
        }
        if let Some(guard) = &self.guard {
            guard.mapped(outcome.torques.as_ref(), outcome.peak_half_width.as_ref());
        }
        outcome.detection = self.detection(&outcome, sample);
        outcome
    }

    /// Whether the external torque of a sample is a contact, if the arm was identified.
    fn detection(&self, outcome: &StepOutcome, sample: &Sample) -> Option<Detection> {
        let ((torque, _), std) = outcome.torques.as_ref().zip(sample.tau_std.as_ref())?;
        let external =
            ExternalTorque { torque: torque.clone(), std: DVector::from_column_slice(std) };
        let touched = external.statistic() > self.identified.as_ref()?.threshold;
        Some(Detection { std_n_m: std.clone(), touched })
    }

    /// Whether the guard refuses these samples of a pause as a tare.
    fn is_loaded(&self, tare: &[&Sample]) -> bool {
        let Some(guard) = &self.guard else { return false };
        let (config, robot) = (&self.mapper.config().touch, &self.mapper.arm().robot);
        if config.tare == Tare::None {
            return false;
        }
        let untared = |sample: &&Sample| {
            let poses = robot.forward(&sample.q).ok()?;
            config.untared(robot, &poses, &sample.tau).ok()
        };
        let untared: Vec<DVector<f64>> = tare.iter().filter_map(untared).collect();
        let sum = untared.iter().fold(DVector::zeros(robot.n_joints()), |sum, next| sum + next);
        untared.is_empty() || guard.tare(&(sum / untared.len() as f64)).is_err()
    }

    /// Whether the arm is elsewhere than at the last sample, and it is unknown which way it has gone.
    fn has_jumped(&self, sample: &Sample) -> bool {
        let Some(last) = &self.last else { return false };
        let (Some(last_s), Some(now_s)) = (last.time_s, sample.time_s) else { return false };
        let elapsed_s = now_s - last_s;
        let robot = &self.mapper.arm().robot;
        let ways = robot.difference(&last.q, &sample.q);
        robot.joints().iter().zip(ways).any(|(joint, way)| {
            let fastest = joint.velocity.filter(|speed| *speed > 0.0).unwrap_or(FASTEST);
            let unknown = elapsed_s > GAP_S || way.abs() > TOO_FAST * fastest * elapsed_s;
            unknown && way.abs() > LEAST_JUMP
        })
    }

    /// Takes the result of a step that went well.
    fn learnt(&mut self, report: StepReport, outcome: &mut StepOutcome) {
        outcome.contacts = report.contacts;
        let (Some(external), Some(predicted)) = (report.external, report.predicted) else {
            self.state = State::Taring;
            return;
        };
        // A touch that began where the arm had jumped has a tare that no pause has given.
        let tared = self.state == State::Taring && self.mapper.config().touch.tare != Tare::None;
        if tared
            && let Some((guard, tare)) = self.guard.as_ref().zip(self.mapper.tare())
            && guard.tare(tare).is_err()
        {
            return self.wait();
        }
        self.state = State::Mapping;
        (outcome.torques, outcome.peak_half_width) =
            (Some((external, predicted)), report.peak_half_width);
    }

    /// Takes the error of a step that failed.
    fn failed(&mut self, error: &MapperError, outcome: &mut StepOutcome) {
        outcome.fault = Some(error.to_string());
        // A single broken sample is left out; where an arm has jumped, the touch is lost.
        let lost = matches!(
            error,
            MapperError::Tracker(
                TrackerError::Jump { .. }
                    | TrackerError::NoContactFreeStart { .. }
                    | TrackerError::NotBegun
            )
        );
        if lost {
            self.wait();
        }
    }

    /// Begins a touch with the samples of a pause, if there are any.
    fn begin(&mut self, tare: &[&Sample], outcome: &mut StepOutcome) {
        let _ = self.mapper.end_touch();
        self.mapper.begin_touch();
        (self.state, outcome.begins) = (State::Taring, true);
        outcome.tare = tare.iter().map(|&sample| sample.clone()).collect();
        for sample in tare {
            if let Err(error) = self.mapper.step(sample) {
                return self.failed(&error, outcome);
            }
        }
    }

    /// Begins a touch with the next pause, because somebody says that the arm stands free, whatever
    /// the mapper believes to be touched.
    pub fn tare(&mut self) {
        self.wait();
    }

    /// Ends the touch and waits for a pause: what follows does not go on from what came before.
    pub fn wait(&mut self) {
        let _ = self.mapper.end_touch();
        self.state = State::Waiting;
        self.pauses.clone_from(&self.no_pauses);
    }

    /// Makes two of the replays that the last step may have, or what is left of them; returns how many.
    ///
    /// Two at a time, since `map` draws every other one by its NIS.
    pub fn spare(&mut self) -> u32 {
        let mut pair = 2;
        self.mapper.spare_time(|_| std::mem::take(&mut pair))
    }

    /// Whether the last step may have more replays.
    pub fn has_spare(&self) -> bool {
        self.mapper.spare_replays() > 0
    }

    /// What the session does.
    pub fn state(&self) -> State {
        self.state
    }

    /// The guard, if there is one.
    pub fn guard(&self) -> Option<&Guard> {
        self.guard.as_ref()
    }

    /// The mapper.
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// Ends the touch under way.
    pub fn finish(&mut self) {
        while self.spare() > 0 {}
        self.wait();
    }
}
