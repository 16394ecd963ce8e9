//! Checks each joint state on arrival, before it waits for the mapper.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use nalgebra::DVector;
use palpate::{Arm, ExternalTorqueConfig, MAX_TORQUE};

use super::Guard;
use crate::joints::JointReader;
use crate::message::JointState;

/// If gravity exerts a larger torque than this on some joint, N·m, efforts of exactly zero are wrong.
const MIN_WEIGHT: f64 = 1.0;
/// An arm faster than this, rad/s or m/s, on average over [`SPEED_OVER`], cannot stop from one sample to the
/// next.
const MIN_SPEED: f64 = 0.1;
/// Time over which the speed is averaged.
const SPEED_OVER: Duration = Duration::from_millis(100);

pub(crate) const ALL_ZERO: &str =
    "all efforts are exactly 0, though the arm bears its own weight; does the driver publish them?";
const FROZEN: &str = "positions and efforts repeat to the last bit, and the arm moved just before; does the driver hang?";

/// Whether all efforts are exactly zero although the joints carry the weight of the arm. `untared`: torques before the
/// tare, which are then the torques of gravity alone, n_joints, N·m.
pub(crate) fn are_all_zero(efforts: &[f64], untared: &DVector<f64>) -> bool {
    efforts.iter().all(|effort| *effort == 0.0) && untared.amax() > MIN_WEIGHT
}

/// Checks joint states on arrival, and reports them to a guard.
pub struct JointStateMonitor {
    guard: Guard,
    arm: Arc<Arm>,
    config: ExternalTorqueConfig,
    reader: JointReader,
    /// Last known joint positions; NaN before the first.
    q: Vec<f64>,
    last: Option<Last>,
}

/// The last joint state, and earlier positions.
struct Last {
    /// Its positions and efforts, as bits: NaN equals itself.
    bits: Vec<u64>,
    /// Arrival of the first of its identical copies.
    since: Instant,
    moved: bool,
    /// Positions with their arrival, over the last [`SPEED_OVER`].
    before: VecDeque<(Instant, Vec<f64>)>,
}

impl JointStateMonitor {
    /// A monitor for an arm; `config` are sign, gravity and tare of its torques.
    pub fn new(guard: Guard, arm: Arc<Arm>, config: ExternalTorqueConfig) -> Self {
        let joints: Vec<String> = arm.robot.joint_names().map(str::to_owned).collect();
        let q = vec![f64::NAN; joints.len()];
        Self { guard, arm, config, reader: JointReader::new(joints), q, last: None }
    }

    /// Checks a joint state that arrived at `now`, or the reason why it cannot be decoded. `received_s` is
    /// the time of arrival for messages without a stamp, s.
    ///
    /// A torque is checked even if the stamp or other values of the joint state are invalid.
    pub fn see(&mut self, state: Result<&JointState, &str>, now: Instant, received_s: f64) {
        let state = match state {
            Ok(state) => state,
            Err(why) => return self.guard.refused(&why),
        };
        let (q, tau) = match self.reader.joints(state) {
            Ok(joints) => joints,
            Err(refusal) => return self.guard.refused(&refusal),
        };
        let Some(untared) = self.untared(&q, &tau) else {
            return self
                .guard
                .refused(&"the pose of the arm cannot be computed from its joint positions");
        };
        let is_dead = are_all_zero(&tau, &untared);
        self.guard.measured(untared);
        if self.is_frozen(q, &tau, now) {
            return self.guard.refused(&FROZEN);
        }
        if is_dead {
            return self.guard.refused(&ALL_ZERO);
        }
        match self.reader.read(state, received_s) {
            Ok(_) => self.guard.usable(now),
            Err(refusal) => self.guard.refused(&refusal),
        }
    }

    /// Whether the driver has repeated a joint state for longer than the allowed silence, although the arm moved just
    /// before.
    fn is_frozen(&mut self, q: Vec<f64>, tau: &[f64], now: Instant) -> bool {
        let bits: Vec<u64> = q.iter().chain(tau).map(|number| number.to_bits()).collect();
        let passed = |since: Instant| now.saturating_duration_since(since);
        if let Some(last) = self.last.as_ref().filter(|last| last.bits == bits) {
            return last.moved && passed(last.since) > self.guard.config.silence;
        }
        let mut before = self.last.take().map(|last| last.before).unwrap_or_default();
        before.push_back((now, q));
        // Keep only the newest of the positions older than the window.
        while before.get(1).is_some_and(|(since, _)| passed(*since) >= SPEED_OVER) {
            before.pop_front();
        }
        let ((since, first), (_, q)) = (&before[0], &before[before.len() - 1]);
        let ways = q.iter().zip(first).map(|(now, before)| (now - before).abs());
        let way = ways.fold(0.0, f64::max);
        let moved = way > MIN_SPEED * passed(*since).max(SPEED_OVER).as_secs_f64();
        self.last = Some(Last { bits, since: now, moved, before });
        false
    }

    /// Torques before the tare, n_joints, N·m; NaN where the effort is NaN. A joint without a valid position
    /// is taken at its last known one.
    fn untared(&mut self, q: &[f64], tau: &[f64]) -> Option<DVector<f64>> {
        for (last, now) in self.q.iter_mut().zip(q) {
            *last = if now.is_finite() { *now } else { *last };
        }
        let robot = &self.arm.robot;
        let poses = robot.forward(&self.q).ok()?;
        // A torque beyond the range of any sensor exceeds every limit, also when clamped.
        let readable = |torque: &f64| match torque.is_nan() {
            true => 0.0,
            false => torque.clamp(-MAX_TORQUE, MAX_TORQUE),
        };
        let readable: Vec<f64> = tau.iter().map(readable).collect();
        let mut untared = self.config.untared(robot, &poses, &readable).ok()?;
        for (joint, torque) in tau.iter().enumerate() {
            if torque.is_nan() {
                untared[joint] = f64::NAN;
            }
        }
        Some(untared)
    }
}
