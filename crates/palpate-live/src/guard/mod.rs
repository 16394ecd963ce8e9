//! `--guard`: a stop flag that is up unless the robot is known to be safe.
//!
//! The flag is down only while all of this holds: joint states come and can be used, the mapper keeps
//! up, there is a tare with little bias, and no joint's external torque exceeds the limit, neither
//! measured nor predicted. A [`JointStateMonitor`] checks each joint state on arrival, before it waits for the
//! mapper; predicted torque and tare come from the mapper. Silence is detected when [`Guard::cause`]
//! is called.
//!
//! The flag goes down by itself only once, with the first tare. If it is raised later, it stays up
//! until the guard is reset: a robot that stopped while pressing on something must not start again
//! because the torque has dropped.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use nalgebra::DVector;
use palpate::Arm;

use crate::threads::lock;

pub use cause::{Cause, TorqueSource};
pub use joint_state_monitor::JointStateMonitor;
pub(crate) use joint_state_monitor::{ALL_ZERO, are_all_zero};

mod cause;
mod joint_state_monitor;
#[cfg(test)]
mod tests;

/// Thresholds at which the flag goes up.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GuardConfig {
    /// Largest allowed external torque of a joint, N·m (N for a prismatic joint).
    pub limit_n_m: f64,
    /// Largest bias: difference between torque and gravity for an arm at rest without contact, N·m (N).
    /// If it is exceeded, the arm is loaded or has an unknown payload, and the tare is refused.
    pub bias_limit_n_m: f64,
    /// Largest time without a usable joint state.
    pub silence: Duration,
    /// Largest time that a joint state may wait for the mapper.
    pub lag: Duration,
}

impl GuardConfig {
    /// Thresholds for a limit, N·m (N for a prismatic joint), with 0.1 s of silence and 0.25 s of lag. The
    /// limit of the bias is the same.
    pub fn new(limit_n_m: f64) -> Self {
        Self {
            limit_n_m,
            bias_limit_n_m: limit_n_m,
            silence: Duration::from_millis(100),
            lag: Duration::from_millis(250),
        }
    }
}

/// Largest change of an automatic tare from that of the free arm, as a share of the limit; a larger one is refused. The
/// torque at which the flag goes up may shift by this much.
const MAX_CHANGE: f64 = 0.5;

/// Watches the external torque. All clones share one state.
#[derive(Debug, Clone)]
pub struct Guard {
    config: GuardConfig,
    joints: Arc<[String]>,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    ended: bool,
    /// Tare: bias of the measured torques, n_joints, N·m.
    tare: Option<DVector<f64>>,
    /// Tare of the free arm: the first one, or the last requested one, n_joints, N·m.
    free: Option<DVector<f64>>,
    /// Last torques before subtracting the tare, n_joints, N·m; NaN if unknown.
    untared: Option<DVector<f64>>,
    /// The limit exceeded at the mapper's last step, if any.
    mapped_over: Option<Cause>,
    /// Why the last tare was refused, if it was.
    loaded: Option<Cause>,
    /// Arrival of the last usable joint state.
    usable: Option<Instant>,
    /// Why a later joint state cannot be used.
    refused: Option<String>,
    /// Time since which joint states wait for the mapper.
    waiting: Option<Instant>,
    /// Whether the flag has been down.
    was_down: bool,
    /// The cause that has raised it since then.
    raised: Option<Cause>,
    /// Whether the next tare takes the flag down: a user has requested it, so the arm is free of contact.
    resets: bool,
    /// Whether the joint positions jump back and forth.
    jumping: bool,
}

impl Guard {
    /// A guard for the joints of an arm.
    pub fn new(config: GuardConfig, arm: &Arm) -> Self {
        let joints = arm.robot.joint_names().map(str::to_owned).collect();
        Self { config, joints, state: Arc::default() }
    }

    /// Why the flag is up at a moment; `None` if it is down.
    pub fn cause(&self, now: Instant) -> Option<Cause> {
        let mut state = lock(&self.state);
        if state.raised.is_none() {
            let cause = self.unsafe_now(&state, now);
            match cause {
                None => state.was_down = true,
                Some(cause) if !state.was_down => return Some(cause),
                Some(_) => state.raised = cause,
            }
        }
        state.raised.clone()
    }

    /// The most urgent unsafe condition at `now`, if there is one.
    fn unsafe_now(&self, state: &State, now: Instant) -> Option<Cause> {
        let longer = |since: Instant, time| now.saturating_duration_since(since) > time;
        if state.ended {
            return Some(Cause::Ended);
        }
        let measured = state.untared.as_ref().zip(state.tare.as_ref());
        let over = measured
            .and_then(|(untared, tare)| self.over(&(untared - tare), TorqueSource::Measured));
        if let Some(over) = over.or_else(|| state.mapped_over.clone()) {
            return Some(over);
        }
        if state.usable.is_none_or(|usable| longer(usable, self.config.silence)) {
            return Some(state.refused.clone().map_or(Cause::Silence, Cause::Refused));
        }
        if state.waiting.is_some_and(|since| longer(since, self.config.lag)) {
            return Some(Cause::Lag);
        }
        if state.jumping {
            return Some(Cause::Jumping);
        }
        state.loaded.clone().or_else(|| state.tare.is_none().then_some(Cause::Untared))
    }

    /// The joint with the largest torque, if it exceeds the limit. `torques`: n_joints, N·m; NaN if unknown.
    fn over(&self, torques: &DVector<f64>, of: TorqueSource) -> Option<Cause> {
        let (joint, &torque_n_m) = largest(torques)?;
        (torque_n_m.abs() > self.config.limit_n_m).then(|| Cause::Limit {
            joint: self.joints[joint].clone(),
            torque_n_m,
            of,
        })
    }

    /// Records a usable joint state. The cause is evaluated first: if the whole process stood still since
    /// the last one, that silence must count.
    fn usable(&self, now: Instant) {
        self.cause(now);
        let mut state = lock(&self.state);
        (state.usable, state.refused) = (Some(now), None);
        state.waiting.get_or_insert(now);
    }

    /// Records a joint state that cannot be used.
    fn refused(&self, why: &impl ToString) {
        lock(&self.state).refused = Some(why.to_string());
    }

    /// Records measured torques before subtracting the tare, n_joints, N·m; NaN if unknown.
    fn measured(&self, untared: DVector<f64>) {
        lock(&self.state).untared = Some(untared);
    }

    /// Records that the mapper has taken all joint states that arrived until `came`; `some_wait`: whether
    /// later ones wait.
    pub fn taken(&self, came: Instant, some_wait: bool) {
        lock(&self.state).waiting = some_wait.then_some(came);
    }

    /// Checks the torques of the mapper's last step against the limit: measured and predicted, and the predicted one
    /// plus the half-width of its band, if given; n_joints, N·m.
    pub fn mapped(
        &self,
        torques: Option<&(DVector<f64>, DVector<f64>)>,
        half_width: Option<&DVector<f64>>,
    ) {
        let over = torques.and_then(|(measured, predicted)| {
            let band = || {
                let outer = predicted.zip_map(half_width?, |own, width| own + width.copysign(own));
                self.over(&outer, TorqueSource::Band)
            };
            self.over(measured, TorqueSource::Measured)
                .or_else(|| self.over(predicted, TorqueSource::Predicted))
                .or_else(band)
        });
        lock(&self.state).mapped_over = over;
    }

    /// Takes the bias of the torques of an arm at rest, n_joints, N·m, as the tare until the next one.
    ///
    /// # Errors
    ///
    /// If the bias is too large, or differs too much from the tare of the free arm and was not requested; the previous
    /// tare is kept.
    pub fn tare(&self, bias: &DVector<f64>) -> Result<(), Cause> {
        let mut state = lock(&self.state);
        let limit_n_m = self.config.bias_limit_n_m;
        if let Some((joint, &bias_n_m)) = largest(bias)
            && bias_n_m.abs() > limit_n_m
        {
            let joint = self.joints[joint].clone();
            let loaded = Cause::Loaded { joint, bias_n_m, limit_n_m };
            state.loaded = Some(loaded.clone());
            return Err(loaded);
        }
        if let Some(free) = state.free.as_ref().filter(|_| !state.resets)
            && let change = bias - free
            && let Some((joint, &change_n_m)) = largest(&change)
            && change_n_m.abs() > MAX_CHANGE * self.config.limit_n_m
        {
            let joint = self.joints[joint].clone();
            let loaded = Cause::TareChanged { joint, change_n_m };
            state.loaded = Some(loaded.clone());
            return Err(loaded);
        }
        (state.tare, state.loaded) = (Some(bias.clone()), None);
        let is_asked_for = std::mem::take(&mut state.resets);
        if is_asked_for {
            (state.raised, state.mapped_over) = (None, None);
        }
        if is_asked_for || state.free.is_none() {
            state.free = Some(bias.clone());
        }
        Ok(())
    }

    /// Records that a tare is refused since sign or gravity of the torques seem wrong.
    pub(crate) fn misread(&self, why: &str) {
        lock(&self.state).loaded = Some(Cause::Misread(why.to_owned()));
    }

    /// Records whether the joint positions jump back and forth.
    pub(crate) fn jumping(&self, jumping: bool) {
        lock(&self.state).jumping = jumping;
    }

    /// Lets the next accepted tare take the flag down: a user has requested it, so the arm is free of contact.
    pub(crate) fn reset_with_tare(&self) {
        lock(&self.state).resets = true;
    }

    /// Takes the flag down.
    ///
    /// # Errors
    ///
    /// Returns the unsafe condition if there is one; the flag then stays up.
    pub fn reset(&self, now: Instant) -> Result<(), Cause> {
        let mut state = lock(&self.state);
        match self.unsafe_now(&state, now) {
            Some(cause) => Err(cause),
            None => {
                state.raised = None;
                Ok(())
            }
        }
    }

    /// Raises the flag if it has been down before, since its state was not sent for too long.
    pub(crate) fn stalled(&self) {
        let mut state = lock(&self.state);
        if state.was_down {
            state.raised.get_or_insert(Cause::Stalled);
        }
    }

    /// Raises the flag permanently.
    pub fn end(&self) {
        lock(&self.state).ended = true;
    }
}

/// Index and value of the number with the largest absolute value, without NaN.
fn largest(numbers: &DVector<f64>) -> Option<(usize, &f64)> {
    let known = numbers.iter().enumerate().filter(|(_, number)| !number.is_nan());
    known.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
}
