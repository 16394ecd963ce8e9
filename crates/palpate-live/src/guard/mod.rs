//! `--guard`: a flag to stop that is up until it is known to be safe.
//!
//! The flag is down only while all of this holds: joint states come and can be used, the mapper keeps
//! up, a tare is known that gravity explains, and no joint's external torque passes the limit,
//! neither the measured nor the predicted one. A [`Sentry`] looks at each joint state as it comes in,
//! before it waits for the mapper; the predicted torque and the tare are the mapper's. Silence is
//! seen by whoever asks: [`Guard::cause`] is a question about a moment.
//!
//! The flag comes down by itself once, with the first tare. What raises it after that stays up until
//! somebody resets the guard: a robot that stopped where it presses must not start again because it
//! no longer moves.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use nalgebra::DVector;
use palpate::Arm;

pub use cause::{Cause, Torque};
pub use sentry::Sentry;
pub(crate) use sentry::{DEAD, are_dead};

mod cause;
mod sentry;
#[cfg(test)]
mod tests;

/// When the flag goes up.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GuardConfig {
    /// The largest external torque of a joint, N·m (N for a prismatic joint).
    pub limit_n_m: f64,
    /// The most by which the torques of an arm that stands free may differ from gravity, N·m (N).
    /// More is a load, or a payload that palpate does not know of: then the tare is refused.
    pub bias_limit_n_m: f64,
    /// The longest time without a joint state that can be used.
    pub silence: Duration,
    /// The longest time that a joint state may wait for the mapper.
    pub lag: Duration,
}

impl GuardConfig {
    /// For a limit, N·m (N for a prismatic joint), with 0.1 s of silence and 0.25 s of lag. What is
    /// no load for the limit is none for the tare.
    pub fn new(limit_n_m: f64) -> Self {
        Self {
            limit_n_m,
            bias_limit_n_m: limit_n_m,
            silence: Duration::from_millis(100),
            lag: Duration::from_millis(250),
        }
    }
}

/// Without being asked for, a tare is at most so far from that of the free arm, as a share of the limit: a stop may come later by
/// as much.
const MOST_CHANGE: f64 = 0.5;

/// Watches the external torque. Clones are one guard.
#[derive(Debug, Clone)]
pub struct Guard {
    config: GuardConfig,
    joints: Arc<[String]>,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    ended: bool,
    /// Bias of the measured torques, n_joints, N·m.
    tare: Option<DVector<f64>>,
    /// The first tare, or the last that somebody asked for.
    free: Option<DVector<f64>>,
    /// The last torques before the tare, n_joints, N·m, NaN where nobody knows.
    untared: Option<DVector<f64>>,
    /// The joint whose torque passed the limit at the mapper's last step.
    mapped_over: Option<Cause>,
    /// The last tare was refused.
    loaded: Option<Cause>,
    /// When the last joint state came that can be used, and why one since then cannot.
    usable: Option<Instant>,
    refused: Option<String>,
    /// Since when joint states wait for the mapper.
    waiting: Option<Instant>,
    /// Whether the flag has been down, and what has raised it since.
    was_down: bool,
    raised: Option<Cause>,
    /// Whether the next tare takes the flag back, since somebody says that the arm stands free.
    resets: bool,
    /// The joint positions jump back and forth.
    jumping: bool,
}

impl Guard {
    /// A guard of an arm's joints.
    pub fn new(config: GuardConfig, arm: &Arm) -> Self {
        let joints = arm.robot.joint_names().map(str::to_owned).collect();
        Self { config, joints, state: Arc::default() }
    }

    /// Why the flag is up at a moment; `None` if it is down.
    pub fn cause(&self, now: Instant) -> Option<Cause> {
        let mut state = self.state();
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

    /// What is not safe at a moment, the most urgent first.
    fn unsafe_now(&self, state: &State, now: Instant) -> Option<Cause> {
        let longer = |since: Instant, time| now.saturating_duration_since(since) > time;
        if state.ended {
            return Some(Cause::Ended);
        }
        let measured = state.untared.as_ref().zip(state.tare.as_ref());
        let over =
            measured.and_then(|(untared, tare)| self.over(&(untared - tare), Torque::Measured));
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

    /// The joint whose torque passes the limit by most, n_joints, N·m, NaN where nobody knows.
    fn over(&self, torques: &DVector<f64>, of: Torque) -> Option<Cause> {
        let (joint, &torque_n_m) = largest(torques)?;
        (torque_n_m.abs() > self.config.limit_n_m).then(|| Cause::Limit {
            joint: self.joints[joint].clone(),
            torque_n_m,
            of,
        })
    }

    /// A joint state came that can be used. Nobody may have asked since the one before it, if all of
    /// palpate had stopped for a while: then the silence counts as well.
    fn usable(&self, now: Instant) {
        self.cause(now);
        let mut state = self.state();
        (state.usable, state.refused) = (Some(now), None);
        state.waiting.get_or_insert(now);
    }

    /// A joint state came that cannot be used.
    fn refused(&self, why: &impl ToString) {
        self.state().refused = Some(why.to_string());
    }

    /// Torques before the tare came, n_joints, N·m, NaN where nobody knows.
    fn measured(&self, untared: DVector<f64>) {
        self.state().untared = Some(untared);
    }

    /// The mapper has taken all joint states that came until a moment, and none waits any more or
    /// some still do.
    pub fn taken(&self, came: Instant, some_wait: bool) {
        self.state().waiting = some_wait.then_some(came);
    }

    /// Looks at the torques of the mapper's last step, measured and predicted, if it had any, and at the half-width of the
    /// band around the latter, if that is asked for, n_joints, N·m.
    pub fn mapped(
        &self,
        torques: Option<&(DVector<f64>, DVector<f64>)>,
        half_width: Option<&DVector<f64>>,
    ) {
        let over = torques.and_then(|(measured, predicted)| {
            let band = || {
                let outer = predicted.zip_map(half_width?, |own, width| own + width.copysign(own));
                self.over(&outer, Torque::Band)
            };
            self.over(measured, Torque::Measured)
                .or_else(|| self.over(predicted, Torque::Predicted))
                .or_else(band)
        });
        self.state().mapped_over = over;
    }

    /// Takes the bias of the torques of an arm that stands still, n_joints, N·m, as the tare, which
    /// counts until the next one.
    ///
    /// # Errors
    ///
    /// If gravity does not explain the torques, or they are far from those of the arm when it stood free, and nobody asked for
    /// this tare; the tare before still counts.
    pub fn tare(&self, bias: &DVector<f64>) -> Result<(), Cause> {
        let mut state = self.state();
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
            && change_n_m.abs() > MOST_CHANGE * self.config.limit_n_m
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

    /// The torques of an arm that stands still say that they are read wrongly: the tare is refused.
    pub(crate) fn misread(&self, why: &str) {
        self.state().loaded = Some(Cause::Misread(why.to_owned()));
    }

    /// Whether the joint positions jump back and forth, so that the arm cannot be followed.
    pub(crate) fn jumping(&self, jumping: bool) {
        self.state().jumping = jumping;
    }

    /// Lets the next tare take the flag back: somebody is there who says that the arm stands free.
    pub(crate) fn reset_with_tare(&self) {
        self.state().resets = true;
    }

    /// Takes the flag back.
    ///
    /// # Errors
    ///
    /// What is not safe now; the flag stays up.
    pub fn reset(&self, now: Instant) -> Result<(), Cause> {
        let mut state = self.state();
        match self.unsafe_now(&state, now) {
            Some(cause) => Err(cause),
            None => {
                state.raised = None;
                Ok(())
            }
        }
    }

    /// Raises a flag that was down: nobody said so for too long.
    pub(crate) fn stalled(&self) {
        let mut state = self.state();
        if state.was_down {
            state.raised.get_or_insert(Cause::Stalled);
        }
    }

    /// Raises the flag for good.
    pub fn end(&self) {
        self.state().ended = true;
    }

    /// No thread panics while it holds the lock; if one did, the state would still be whole.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The number that is largest without its sign, and its place, among those that are numbers.
fn largest(numbers: &DVector<f64>) -> Option<(usize, &f64)> {
    let known = numbers.iter().enumerate().filter(|(_, number)| !number.is_nan());
    known.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
}
