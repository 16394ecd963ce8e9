//! Each joint state as it comes in, before it waits for the mapper.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::DVector;
use palpate::{Arm, ExternalTorqueConfig, MAX_TORQUE};

use super::Guard;
use crate::joints::JointReader;
use crate::message::JointState;

/// Weight of the arm, the largest torque of a joint, N·m, that a working sensor feels.
const LEAST_WEIGHT: f64 = 1.0;
/// An arm that went so far, rad or m, since the joint state before, and so fast, rad/s or m/s, cannot stand still at once.
const LEAST_WAY: f64 = 2e-4;
const LEAST_SPEED: f64 = 0.05;

pub(crate) const DEAD: &str =
    "all efforts are exactly 0, though the arm bears its own weight; does the driver publish them?";
const FROZEN: &str = "positions and efforts repeat to the last bit, and the arm moved just before; does the driver hang?";

/// Whether efforts say nothing: all of them are exactly zero, and the arm bears its own weight. `untared` are then the torques
/// of that alone, n_joints, N·m.
pub(crate) fn are_dead(efforts: &[f64], untared: &DVector<f64>) -> bool {
    efforts.iter().all(|effort| *effort == 0.0) && untared.amax() > LEAST_WEIGHT
}

/// Watches joint states as they come in.
pub struct Sentry {
    guard: Guard,
    arm: Arc<Arm>,
    config: ExternalTorqueConfig,
    reader: JointReader,
    /// Where the joints were last, NaN before anybody knew.
    q: Vec<f64>,
    last: Option<Last>,
}

/// Positions and efforts of a joint state, when they came first, and whether the arm moved then.
struct Last {
    numbers: [Vec<f64>; 2],
    since: Instant,
    moved: bool,
}

impl Sentry {
    /// A sentry for an arm whose torques are logged as these settings say.
    pub fn new(guard: Guard, arm: Arc<Arm>, config: ExternalTorqueConfig) -> Self {
        let joints: Vec<String> = arm.robot.joint_names().map(str::to_owned).collect();
        let q = vec![f64::NAN; joints.len()];
        Self { guard, arm, config, reader: JointReader::new(joints), q, last: None }
    }

    /// Looks at a joint state, or why it cannot be decoded, which came at a moment and by the
    /// system's clock at `received_s`, s.
    ///
    /// Torques count whatever else is wrong with it: its stamp, or the torques of other joints.
    pub fn see(&mut self, state: Result<&JointState, &str>, now: Instant, received_s: f64) {
        let state = match state {
            Ok(state) => state,
            Err(why) => return self.guard.refused(&why),
        };
        let untared = match self.reader.joints(state) {
            Ok((q, tau)) => self.untared(&q, &tau),
            Err(refusal) => return self.guard.refused(&refusal),
        };
        let Some(untared) = untared else {
            return self.guard.refused(&"the arm cannot stand at these joint positions");
        };
        let is_dead = are_dead(&state.effort, &untared);
        self.guard.measured(untared);
        if self.is_frozen(state, now) {
            return self.guard.refused(&FROZEN);
        }
        if is_dead {
            return self.guard.refused(&DEAD);
        }
        match self.reader.read(state, received_s) {
            Ok(_) => self.guard.usable(now),
            Err(refusal) => self.guard.refused(&refusal),
        }
    }

    /// Whether the driver repeats a joint state for longer than it may be silent, of an arm that moved just before.
    fn is_frozen(&mut self, state: &JointState, now: Instant) -> bool {
        let numbers = [state.position.clone(), state.effort.clone()];
        let passed = |last: &Last| now.saturating_duration_since(last.since);
        if let Some(last) = self.last.as_ref().filter(|last| last.numbers == numbers) {
            return last.moved && passed(last) > self.guard.config.silence;
        }
        let moved = self.last.as_ref().is_some_and(|last| {
            let ways =
                numbers[0].iter().zip(&last.numbers[0]).map(|(now, before)| (now - before).abs());
            let way = ways.fold(0.0, f64::max);
            way > LEAST_WAY && way > LEAST_SPEED * passed(last).as_secs_f64()
        });
        self.last = Some(Last { numbers, since: now, moved });
        false
    }

    /// Torques before the tare, n_joints, N·m, NaN where the sensor says nothing. A joint without a
    /// position is taken to be where it was last.
    fn untared(&mut self, q: &[f64], tau: &[f64]) -> Option<DVector<f64>> {
        for (last, now) in self.q.iter_mut().zip(q) {
            *last = if now.is_finite() { *now } else { *last };
        }
        let robot = &self.arm.robot;
        let poses = robot.forward(&self.q).ok()?;
        // What is beyond all sensors is beyond all limits, too.
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
