//! Each joint state as it comes in, before it waits for the mapper.

use std::sync::Arc;
use std::time::Instant;

use nalgebra::DVector;
use palpate::{Arm, ExternalTorqueConfig, MAX_TORQUE};

use super::Guard;
use crate::joints::JointReader;
use crate::message::JointState;

/// Watches joint states as they come in.
pub struct Sentry {
    guard: Guard,
    arm: Arc<Arm>,
    config: ExternalTorqueConfig,
    reader: JointReader,
    /// Where the joints were last, NaN before anybody knew.
    q: Vec<f64>,
}

impl Sentry {
    /// A sentry for an arm whose torques are logged as these settings say.
    pub fn new(guard: Guard, arm: Arc<Arm>, config: ExternalTorqueConfig) -> Self {
        let joints: Vec<String> = arm.robot.joint_names().map(str::to_owned).collect();
        let q = vec![f64::NAN; joints.len()];
        Self { guard, arm, config, reader: JointReader::new(joints), q }
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
        self.guard.measured(untared);
        match self.reader.read(state, received_s) {
            Ok(_) => self.guard.usable(now),
            Err(refusal) => self.guard.refused(&refusal),
        }
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
