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

use std::collections::VecDeque;

use nalgebra::DVector;
use palpate::unstable::{PauseConfig, PauseDetector};
use palpate::{
    ExternalTorque, ExternalTorqueConfig, Gravity, Mapper, MapperError, ReplayPolicy, Sample,
    SettingError, StepReport, Tare, TorqueSign, TorqueStream, TrackerError,
};
use serde::{Deserialize, Serialize};

use crate::guard::{Guard, are_dead};

/// So many samples of a pause are enough for the first tare; a pause of a second holds a thousand,
/// and the mapper has other things to do. Those that follow it count as well.
const TARE_SAMPLES: usize = 100;

/// An arm has jumped if a joint went so many times farther than its speed allows, and at least so
/// far, rad or m: logs are played faster than they were recorded.
const TOO_FAST: f64 = 4.0;
const LEAST_JUMP: f64 = 0.2;
/// After a silence of so long, s, it is unknown which way the arm has gone.
const GAP_S: f64 = 1.0;
/// An arm that jumps so often in so long, s, is several.
const JUMPS: usize = 3;
const JUMPS_S: f64 = 2.0;
/// Torques are read wrongly if those of an arm that stands still differ from gravity by so many times more than in another
/// reading, and by so much, N·m.
const MISREAD: f64 = 3.0;
const LEAST_MISREAD: f64 = 2.0;
/// They are not if other readings leave so much more than theirs, N·m.
const CLEARED: f64 = 1.0;
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
    /// How its torques should be read, if otherwise than they are.
    pub misread: Option<String>,
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
    /// Whether the touch has begun in a pause.
    is_of_pause: bool,
    /// The sample before.
    last: Option<Sample>,
    /// When the arm has jumped lately, s.
    jumps_s: VecDeque<f64>,
    /// How its torques should be read, if not as they are: by the last pause whose torques showed it.
    misread: Option<String>,
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
        Ok(Self {
            mapper,
            pauses,
            no_pauses,
            state,
            is_of_pause: false,
            last: None,
            jumps_s: VecDeque::new(),
            misread: None,
            guard,
            identified: None,
        })
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
            self.jumps_s.extend(sample.time_s);
            self.begin(&[], &mut outcome);
            self.pauses.begun();
        }
        self.look_at_jumps(sample, &mut outcome);
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
            self.look_at_reading(&tare);
            outcome.misread.clone_from(&self.misread);
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
        let config = &self.mapper.config().touch;
        if config.tare == Tare::None {
            return false;
        }
        if let Some(why) = &self.misread {
            guard.misread(why);
            return true;
        }
        self.mean_untared(tare, config).is_none_or(|mean| guard.tare(&mean).is_err())
    }

    /// What these settings leave of the torques of some samples, on average, n_joints, N·m.
    fn mean_untared(
        &self,
        samples: &[&Sample],
        config: &ExternalTorqueConfig,
    ) -> Option<DVector<f64>> {
        let robot = &self.mapper.arm().robot;
        let untared = |sample: &&Sample| {
            let poses = robot.forward(&sample.q).ok()?;
            config.untared(robot, &poses, &sample.tau).ok()
        };
        let untared: Vec<DVector<f64>> = samples.iter().filter_map(untared).collect();
        let sum = untared.iter().fold(DVector::zeros(robot.n_joints()), |sum, next| sum + next);
        (!untared.is_empty()).then(|| sum / untared.len() as f64)
    }

    /// Finds out from a pause how the torques should be read, if far less of them is left in another reading than in that of
    /// the settings; where that is not clear, as where gravity turns no joint, what an earlier pause said still holds.
    fn look_at_reading(&mut self, pause: &[&Sample]) {
        let config = &self.mapper.config().touch;
        if config.tare == Tare::None || self.identified.is_some() {
            return;
        }
        let Some(own) = self.mean_untared(pause, config).map(|own| own.norm()) else { return };
        let signs = [(TorqueSign::Plus, "plus"), (TorqueSign::Minus, "minus")];
        let kinds = [(Gravity::Included, "included"), (Gravity::Removed, "removed")];
        let readings = signs.into_iter().flat_map(|sign| kinds.map(|gravity| (sign, gravity)));
        let others = readings.filter_map(|(sign, gravity)| {
            let mut other = config.clone();
            (other.torque_sign, other.gravity) = (sign.0, gravity.0);
            let differs = other != *config
                && (Gravity::Removed, other.gravity) != (config.gravity, Gravity::Removed);
            let left = differs.then(|| self.mean_untared(pause, &other)).flatten()?;
            Some((left.norm(), sign.1, gravity.1))
        });
        let Some((best, sign, gravity)) = others.min_by(|a, b| a.0.total_cmp(&b.0)) else { return };
        let is_far = |more: f64, less: f64| more > MISREAD * less + LEAST_MISREAD;
        if is_far(own, best) {
            self.misread = Some(format!(
                "where the arm stands still, {own:.1} N·m of its torques are left as they are read, and {best:.1} N·m with \
                 --torque-sign {sign} --gravity {gravity}"
            ));
        } else if best > own + CLEARED {
            self.misread = None;
        }
    }

    /// Whether a sample's torques say nothing: all are exactly zero, and the arm bears its own weight.
    pub fn is_dead(&self, sample: &Sample) -> bool {
        let config = &self.mapper.config().touch;
        let untared = self.identified.is_none().then(|| self.mean_untared(&[sample], config));
        untared.flatten().is_some_and(|untared| are_dead(&sample.tau, &untared))
    }

    /// Finds out whether the arm jumps again and again.
    fn look_at_jumps(&mut self, sample: &Sample, outcome: &mut StepOutcome) {
        let now_s = sample.time_s.unwrap_or_default();
        self.jumps_s.retain(|jump_s| (0.0..JUMPS_S).contains(&(now_s - jump_s)));
        let jumping = self.jumps_s.len() >= JUMPS;
        if jumping {
            outcome.fault = Some(
                "the joint positions jump back and forth: do two drivers publish them?".to_owned(),
            );
        }
        self.guard.as_ref().inspect(|guard| guard.jumping(jumping));
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
        let tared = self.state == State::Taring
            && !self.is_of_pause
            && self.mapper.config().touch.tare != Tare::None;
        if tared
            && let Some((guard, tare)) = self.guard.as_ref().zip(self.mapper.tare())
            && (self.misread.is_some() || guard.tare(tare).is_err())
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
        self.is_of_pause = !tare.is_empty();
        outcome.tare = tare.iter().map(|&sample| sample.clone()).collect();
        for sample in tare {
            if let Err(error) = self.mapper.step(sample) {
                return self.failed(&error, outcome);
            }
        }
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
    pub(crate) fn has_spare(&self) -> bool {
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
