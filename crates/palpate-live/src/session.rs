//! Mapping beside a running robot, sample by sample, without threads or sockets.
//!
//! A touch begins where the arm pauses without contact ([`PauseDetector`]), or at any pause after
//! [`Session::wait`]; until then, nothing is learnt. A sample that cannot be used is left out. If a
//! touch can no longer be followed (because it began without a pause, for instance), it ends, and the next
//! pause begins another one; what was learnt is kept. If the joint positions jump, faster than the joints can
//! move or after a silence, a new touch begins there, as at the start of another recording.
//!
//! Replays are made in spare time: the caller calls [`Session::spare`] while no sample waits. The
//! number of replays for each frame is limited by the settings.

use std::collections::VecDeque;

use nalgebra::DVector;
use palpate::unstable::{LinkId, PauseConfig, PauseDetector, TouchLog};
use palpate::{
    ExternalTorque, ExternalTorqueConfig, Gravity, LinkWrench, Mapper, MapperError, ReplayPolicy,
    Sample, SettingError, StepReport, Tare, TorqueSign, TorqueStream, TrackerError,
};
use serde::{Deserialize, Serialize};

use crate::guard::{Guard, are_all_zero};

/// Largest number of samples of a pause that are used for the first tare, to save time: a pause of a
/// second may have a thousand. Samples after the pause are used as well.
const TARE_SAMPLES: usize = 100;

/// A jump is a joint motion faster than the limit of speed times this factor: logs may be played
/// faster than they were recorded.
const TOO_FAST: f64 = 4.0;
/// A motion smaller than this, rad or m, is no jump.
const MIN_JUMP: f64 = 0.2;
/// After a silence longer than this, s, the path of the arm is unknown, at any speed.
const GAP_S: f64 = 1.0;
/// This many jumps within [`JUMPS_S`] mean that several drivers publish joint positions.
const JUMPS: usize = 3;
/// Window in which jumps are counted, s.
const JUMPS_S: f64 = 2.0;
/// Sign or gravity of the torques is wrong if, for an arm at rest, another combination leaves a much
/// smaller residual r: if the residual of the settings exceeds `MISREAD · r + MIN_MISREAD`, N·m.
const MISREAD: f64 = 3.0;
const MIN_MISREAD: f64 = 2.0;
/// They are right if all other combinations leave a residual larger by this, N·m.
const CLEARED: f64 = 1.0;
/// Most samples that a mapper may lack to take the place of another one: they delay the next sample.
const MAX_LAG: usize = 20;
/// Limit of speed of a joint without one in the URDF, rad/s or m/s.
const FASTEST: f64 = 3.0;

/// State of a session.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SessionState {
    /// Waits for a pause of the arm.
    #[default]
    Waiting,
    /// Takes the tare of a touch.
    Taring,
    /// Learns from samples.
    Mapping,
}

/// Outcome of a sample.
#[derive(Debug, Clone, Default)]
pub struct StepOutcome {
    /// τ_ext, and τ̂ as predicted before the sample was learnt, n_joints, N·m; `None` unless the session
    /// maps.
    pub torques: Option<(DVector<f64>, DVector<f64>)>,
    /// Half-width of the band around τ̂ for the largest torque, n_joints, N·m, if the mapper reports it
    /// ([`Mapper::with_band`]).
    pub peak_half_width: Option<DVector<f64>>,
    /// Number of cells touched.
    pub contacts: usize,
    /// Whether a touch begins with the sample.
    pub begins: bool,
    /// Samples of the pause with which a touch begins, including this one; empty if no touch begins, or if it
    /// begins without a pause.
    pub tare: Vec<Sample>,
    /// Standard deviation of τ_ext and detected contact, for an identified arm.
    pub detection: Option<Detection>,
    /// The wrench that explains τ_ext best, at the link of [`Session::with_wrench_at`].
    pub wrench: Option<(LinkId, LinkWrench)>,
    /// Why the sample or its touch could not be followed.
    pub fault: Option<String>,
    /// Report that sign or gravity of the torques seem wrong, with the flags that fit.
    pub convention_warning: Option<String>,
}

/// Uncertainty of an external torque, and the detected contact.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    /// Standard deviation of τ_ext, n_joints, N·m.
    pub std_n_m: Vec<f64>,
    /// Whether a contact is detected: |τ_ext| of some joint exceeds the threshold.
    pub touched: bool,
}

/// A mapper beside a running robot.
pub struct Session {
    mapper: Mapper,
    pauses: PauseDetector,
    /// The detector before the first sample, to reset `pauses`.
    no_pauses: PauseDetector,
    state: SessionState,
    /// Whether the touch began in a pause.
    is_of_pause: bool,
    /// The previous sample.
    last: Option<Sample>,
    /// Times of the jumps within the last [`JUMPS_S`], s.
    jumps_s: VecDeque<f64>,
    /// Report that sign or gravity of the torques seem wrong, from the last pause that allowed a decision.
    misread: Option<String>,
    guard: Option<Guard>,
    identified: Option<Identified>,
}

/// Whether another mapper has taken the place of the one before ([`Session::go_on_with`]).
pub enum Succession {
    /// It has; the mapper before.
    Done(Box<Mapper>),
    /// It must learn these touches first.
    Behind(Box<Mapper>, TouchLog),
}

/// State of a session with an identified arm.
struct Identified {
    torques: TorqueStream,
    /// |τ_ext| of a joint above which a contact is detected, in standard deviations.
    threshold: f64,
    /// Whether only external torques are computed and nothing is mapped.
    alone: bool,
    /// Link at whose origin the wrench is computed, if nothing is mapped.
    wrench_link: Option<LinkId>,
}

impl Session {
    /// A session of a mapper, whose replays are made in spare time.
    ///
    /// A touch under way in the mapper is ended, since later motion is unknown.
    ///
    /// # Errors
    ///
    /// If a setting of the pause detector is out of its range.
    pub fn new(
        mapper: Mapper,
        pause_config: PauseConfig,
        guard: Option<Guard>,
    ) -> Result<Self, SettingError> {
        let mut mapper = mapper.with_replays(ReplayPolicy::SpareTime);
        // An error means that the touch was too short for its tare: then nothing was learnt from it.
        let _ = mapper.end_touch();
        let no_pauses = PauseDetector::new(pause_config)?;
        let (pauses, state) = (no_pauses.clone(), SessionState::Waiting);
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

    /// Uses an identified arm: samples get external torques with standard deviations ([`Session::external`]). A contact
    /// is detected where the torque of a joint exceeds `threshold` standard deviations. With `alone`, nothing is
    /// mapped.
    #[must_use]
    pub fn identified(mut self, torques: TorqueStream, threshold: f64, alone: bool) -> Self {
        self.identified = Some(Identified { torques, threshold, alone, wrench_link: None });
        self
    }

    /// If nothing is mapped ([`Session::identified`]): also computes the wrench at the origin of a link.
    #[must_use]
    pub fn with_wrench_at(mut self, link: LinkId) -> Self {
        if let Some(identified) = &mut self.identified {
            identified.wrench_link = Some(link);
        }
        self
    }

    /// Whether a field is mapped, rather than external torques alone.
    pub fn maps(&self) -> bool {
        !self.identified.as_ref().is_some_and(|identified| identified.alone)
    }

    /// Prepares a sample of the robot for [`Session::take`]: with an identified arm, replaces its torques by external
    /// torques with standard deviations.
    ///
    /// # Errors
    ///
    /// If the sample does not fit the robot, or has a value that is not finite.
    pub fn external(&mut self, sample: Sample) -> Result<Sample, TrackerError> {
        let has_jumped = self.has_jumped(&sample);
        let Some(identified) = &mut self.identified else { return Ok(sample) };
        if has_jumped {
            identified.torques.begin();
        }
        identified.torques.external(&sample)
    }

    /// Takes the next sample, prepared by [`Session::external`].
    pub fn take(&mut self, sample: &Sample) -> StepOutcome {
        let mut outcome = StepOutcome::default();
        if !self.maps() {
            (self.state, self.last) = (SessionState::Mapping, Some(sample.clone()));
            let torque = DVector::from_column_slice(&sample.tau);
            let nothing = DVector::zeros(torque.len());
            outcome.torques = Some((torque, nothing));
            outcome.detection = self.detection(&outcome, sample);
            outcome.wrench = self.wrench(sample);
            return outcome;
        }
        if self.has_jumped(sample) {
            self.jumps_s.extend(sample.time_s);
            self.begin(&[], &mut outcome);
            self.pauses.begun();
        }
        self.look_at_jumps(sample, &mut outcome);
        self.last = Some(sample.clone());
        if self.state != SessionState::Waiting {
            match self.mapper.step(sample) {
                Ok(report) => self.learnt(report, &mut outcome),
                Err(error) => self.failed(&error, &mut outcome),
            }
        }
        if let Some(tare) = self.pauses.push(sample, outcome.contacts) {
            let every = tare.len().div_ceil(TARE_SAMPLES).max(1);
            let tare: Vec<&Sample> = tare.iter().rev().step_by(every).rev().collect();
            self.look_at_reading(&tare);
            outcome.convention_warning.clone_from(&self.misread);
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

    /// Detects contact from the external torque of a sample, for an identified arm.
    fn detection(&self, outcome: &StepOutcome, sample: &Sample) -> Option<Detection> {
        let ((torque, _), std) = outcome.torques.as_ref().zip(sample.tau_std.as_ref())?;
        let external =
            ExternalTorque { torque: torque.clone(), std: DVector::from_column_slice(std) };
        let touched = external.statistic() > self.identified.as_ref()?.threshold;
        Some(Detection { std_n_m: std.clone(), touched })
    }

    /// The wrench that explains the external torque of a sample, at the link for which it is wanted.
    fn wrench(&self, sample: &Sample) -> Option<(LinkId, LinkWrench)> {
        let link = self.identified.as_ref()?.wrench_link?;
        let robot = &self.mapper.arm().robot;
        let poses = robot.forward(&sample.q).ok()?;
        let [torque, std] =
            [&sample.tau, sample.tau_std.as_ref()?].map(|of| DVector::from_column_slice(of));
        Some((link, ExternalTorque { torque, std }.wrench_at(robot, &poses, link)))
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

    /// Mean torque of samples with these settings, before the tare: sign applied, gravity subtracted; n_joints, N·m.
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

    /// Checks sign and gravity of the torques in a pause: whether another combination leaves a far smaller residual
    /// than that of the settings. If this is not clear, for instance because gravity acts on no joint, the earlier
    /// result is kept.
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
        let is_far = |more: f64, less: f64| more > MISREAD * less + MIN_MISREAD;
        if is_far(own, best) {
            self.misread = Some(format!(
                "while the arm stands still, the residual of its torques is {own:.1} N·m, but {best:.1} N·m with \
                 --torque-sign {sign} --gravity {gravity}"
            ));
        } else if best > own + CLEARED {
            self.misread = None;
        }
    }

    /// Whether all torques of a sample are exactly zero although the joints carry the weight of the arm.
    pub fn is_dead(&self, sample: &Sample) -> bool {
        let config = &self.mapper.config().touch;
        let untared = self.identified.is_none().then(|| self.mean_untared(&[sample], config));
        untared.flatten().is_some_and(|untared| are_all_zero(&sample.tau, &untared))
    }

    /// Checks whether the joint positions jump repeatedly.
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

    /// Whether the arm has moved since the last sample on an unknown path: too fast, or during a silence.
    fn has_jumped(&self, sample: &Sample) -> bool {
        let Some(last) = &self.last else { return false };
        let (Some(last_s), Some(now_s)) = (last.time_s, sample.time_s) else { return false };
        let elapsed_s = now_s - last_s;
        let robot = &self.mapper.arm().robot;
        let ways = robot.difference(&last.q, &sample.q);
        robot.joints().iter().zip(ways).any(|(joint, way)| {
            let fastest = joint.velocity.filter(|speed| *speed > 0.0).unwrap_or(FASTEST);
            let unknown = elapsed_s > GAP_S || way.abs() > TOO_FAST * fastest * elapsed_s;
            unknown && way.abs() > MIN_JUMP
        })
    }

    /// Takes the result of a successful step.
    fn learnt(&mut self, report: StepReport, outcome: &mut StepOutcome) {
        outcome.contacts = report.contacts;
        let (Some(external), Some(predicted)) = (report.external, report.predicted) else {
            self.state = SessionState::Taring;
            return;
        };
        // The guard must also accept the tare of a touch that began at a jump, without a pause.
        let tared = self.state == SessionState::Taring
            && !self.is_of_pause
            && self.mapper.config().touch.tare != Tare::None;
        if tared
            && let Some((guard, tare)) = self.guard.as_ref().zip(self.mapper.tare())
            && (self.misread.is_some() || guard.tare(tare).is_err())
        {
            return self.wait();
        }
        self.state = SessionState::Mapping;
        (outcome.torques, outcome.peak_half_width) =
            (Some((external, predicted)), report.peak_half_width);
    }

    /// Takes the error of a step that failed.
    fn failed(&mut self, error: &MapperError, outcome: &mut StepOutcome) {
        outcome.fault = Some(error.to_string());
        // An invalid sample is left out; after these errors the touch cannot continue.
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
        (self.state, outcome.begins) = (SessionState::Taring, true);
        self.is_of_pause = !tare.is_empty();
        outcome.tare = tare.iter().map(|&sample| sample.clone()).collect();
        for sample in tare {
            if let Err(error) = self.mapper.step(sample) {
                return self.failed(&error, outcome);
            }
        }
    }

    /// Ends the touch and waits for the next pause; later samples do not continue the touch.
    pub fn wait(&mut self) {
        let _ = self.mapper.end_touch();
        self.state = SessionState::Waiting;
        self.pauses.clone_from(&self.no_pauses);
    }

    /// Makes up to two of the remaining replays of the last step; returns how many.
    ///
    /// Two at a time, since `map` chooses every other replay by its NIS.
    pub fn spare(&mut self) -> u32 {
        let mut pair = 2;
        self.mapper.spare_time(|_| std::mem::take(&mut pair))
    }

    /// Whether replays of the last step remain.
    pub(crate) fn has_spare(&self) -> bool {
        self.mapper.spare_replays() > 0
    }

    /// State of the session.
    pub fn state(&self) -> SessionState {
        self.state
    }

    /// The guard, if there is one.
    pub fn guard(&self) -> Option<&Guard> {
        self.guard.as_ref()
    }

    /// Goes on with another mapper of the same arm, which has learnt the touches of the present one with other settings.
    /// If it lacks more than a few samples (`MAX_LAG`), it is returned with the touches that it must still learn.
    ///
    /// # Errors
    ///
    /// If touches are no longer in memory, or the other mapper cannot use a sample; the other mapper is returned.
    pub fn go_on_with(
        &mut self,
        mut other: Box<Mapper>,
    ) -> Result<Succession, (MapperError, Box<Mapper>)> {
        let log = match self.mapper.log_from(other.position()) {
            Ok(log) => log,
            Err(error) => return Err((error, other)),
        };
        if log.n_beyond(other.position(), self.mapper.arm().robot.n_joints()) > MAX_LAG {
            return Ok(Succession::Behind(other, log));
        }
        if let Err(error) = other.catch_up(&log, || true) {
            return Err((error, other));
        }
        other.go_on_after(&log);
        std::mem::swap(&mut self.mapper, &mut other);
        Ok(Succession::Done(other))
    }

    /// The mapper.
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// Makes the remaining replays and ends the touch under way.
    pub fn finish(&mut self) {
        while self.spare() > 0 {}
        self.wait();
    }
}
