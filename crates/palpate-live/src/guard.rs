//! `--guard`: a flag to stop, raised by the first torque beyond a limit.
//!
//! Measured and predicted external torque count alike, joint by joint. The measured one needs the
//! arm's gravity and the tare of a touch and nothing else, so a [`Sentry`] looks at every sample as
//! it comes in, before it waits for the mapper; the predicted one, and the tare, are the mapper's.
//! Until the mapper knows the first tare, nobody watches; then a tare counts until the next one.
//!
//! The flag stays up until it is taken back by a new tare: a robot that stopped where it presses
//! must not start again because it no longer moves.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use nalgebra::DVector;
use palpate::{Arm, ExternalTorqueConfig};
use serde::{Deserialize, Serialize};

use crate::joints::JointReader;
use crate::message::JointState;

/// What passed the limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trip {
    /// Number of the joint, from 0.
    pub joint: usize,
    /// Its torque, N·m.
    pub torque_n_m: f64,
    /// Whether that was predicted, or else measured.
    pub predicted: bool,
}

/// Watches the external torque. Clones are one guard: the first that sees the limit passed raises
/// the flag for all.
#[derive(Debug, Clone)]
pub struct Guard {
    limit_n_m: f64,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    trip: Option<Trip>,
    /// Bias of the measured torques, n_joints, N·m.
    tare: Option<DVector<f64>>,
}

impl Guard {
    /// A guard of a limit, N·m (N for a prismatic joint).
    pub fn new(limit_n_m: f64) -> Self {
        Self { limit_n_m, state: Arc::default() }
    }

    /// Looks at torques of a step, n_joints, N·m; `Some` if this is the first to pass the limit.
    pub fn watch(&self, measured: &DVector<f64>, predicted: &DVector<f64>) -> Option<Trip> {
        self.first(|_| self.passed(measured, false).or_else(|| self.passed(predicted, true)))
    }

    /// Looks at torques before the tare, n_joints, N·m, as [`Guard::watch`] at measured ones;
    /// `None` as long as no tare is known.
    pub fn watch_untared(&self, untared: &DVector<f64>) -> Option<Trip> {
        self.first(|state| self.passed(&(untared - state.tare.as_ref()?), false))
    }

    /// Notes what passed the limit, unless something did before.
    fn first(&self, passed: impl FnOnce(&State) -> Option<Trip>) -> Option<Trip> {
        let mut state = self.state();
        if state.trip.is_some() {
            return None;
        }
        state.trip = passed(&state);
        state.trip.clone()
    }

    fn passed(&self, torques: &DVector<f64>, predicted: bool) -> Option<Trip> {
        let joint = torques.iamax();
        let torque_n_m = torques[joint];
        (torque_n_m.abs() > self.limit_n_m).then_some(Trip { joint, torque_n_m, predicted })
    }

    /// Whether the flag is up.
    pub fn is_up(&self) -> bool {
        self.state().trip.is_some()
    }

    /// Takes note of the tare of a touch, n_joints, N·m.
    pub fn tared(&self, tare: &DVector<f64>) {
        let tare = Some(tare.clone());
        self.state().tare = tare;
    }

    /// Takes the flag back, and forgets the tare: another is about to be taken.
    pub fn reset(&self) {
        *self.state() = State::default();
    }

    /// No thread panics while it holds the lock; if one did, the state would still be whole.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Watches joint states as they come in.
pub struct Sentry {
    guard: Guard,
    arm: Arc<Arm>,
    config: ExternalTorqueConfig,
    reader: JointReader,
}

impl Sentry {
    /// A sentry for an arm whose torques are logged as these settings say.
    pub fn new(guard: Guard, arm: Arc<Arm>, config: ExternalTorqueConfig) -> Self {
        let reader = JointReader::new(arm.robot.joint_names().map(str::to_owned).collect());
        Self { guard, arm, config, reader }
    }

    /// Looks at a joint state, which came at `received_s`, s; `Some` if its measured torque is the
    /// first to pass the limit. The mapper reports what cannot be used.
    pub fn see(&mut self, state: &JointState, received_s: f64) -> Option<Trip> {
        let sample = self.reader.read(state, received_s).ok()?.sample;
        let robot = &self.arm.robot;
        let poses = robot.forward(&sample.q).ok()?;
        self.guard.watch_untared(&self.config.untared(robot, &poses, &sample.tau).ok()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::dvector;

    #[test]
    fn the_first_torque_beyond_the_limit_raises_the_flag_and_no_other() {
        let guard = Guard::new(5.0);
        let calm = dvector![1.0, -5.0];
        assert_eq!(guard.watch(&calm, &calm), None);
        let trip = Trip { joint: 1, torque_n_m: -5.1, predicted: false };
        assert_eq!(guard.watch(&dvector![0.0, -5.1], &dvector![9.0, 0.0]), Some(trip));
        assert_eq!(guard.watch(&dvector![0.0, -7.0], &calm), None);
        assert!(guard.is_up());
        guard.reset();
        let trip = Trip { joint: 0, torque_n_m: 6.0, predicted: true };
        assert_eq!(guard.watch(&calm, &dvector![6.0, 0.0]), Some(trip));
    }

    #[test]
    fn measured_torques_are_watched_from_the_first_tare_on_and_by_every_clone() {
        let guard = Guard::new(5.0);
        let early = guard.clone();
        let pressed = dvector![7.0, -1.0];
        assert_eq!(early.watch_untared(&pressed), None, "no tare yet");
        guard.tared(&dvector![3.0, 0.0]);
        assert_eq!(early.watch_untared(&pressed), None, "4 N·m without the bias");
        guard.tared(&dvector![-3.0, 0.0]);
        let trip = Trip { joint: 0, torque_n_m: 10.0, predicted: false };
        assert_eq!(early.watch_untared(&pressed), Some(trip));
        assert_eq!(guard.watch(&pressed, &pressed), None, "the flag is up already");
        guard.reset();
        assert!(!early.is_up());
        assert_eq!(early.watch_untared(&pressed), None, "the tare is being taken");
    }
}
