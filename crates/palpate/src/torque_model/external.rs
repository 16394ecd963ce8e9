//! External torque of every sample of a touch: what is measured, less what the model says the arm itself takes.
//!
//! The motion is computed at the time of the torque less the delay. Beside a running robot the window ends now, so some
//! of it lies after that time. Where a log has no clock, or one that is slower than the window, speeds are not known: gravity, bias and
//! Coulomb friction are taken off, and the rest is in the standard deviation.

use std::sync::Arc;

use nalgebra::DVector;

use super::{FrictionState, LocalPolynomial, Side, TorqueModel};
use crate::arm::Arm;
use crate::external_torque::{ExternalTorqueConfig, Gravity, TorqueSign};
use crate::robot::Robot;
use crate::tracker::{Sample, TrackerError};

/// External torque at a sample.
#[derive(Debug, Clone, PartialEq)]
pub struct ExternalTorque {
    /// n_joints, N·m, as the environment exerts it on the joints.
    pub torque: DVector<f64>,
    /// Standard deviation of that, n_joints, N·m.
    pub std: DVector<f64>,
}

/// How a joint moves at a time, with the state of its friction.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Motion {
    /// Positions, n_joints, rad or m.
    pub q: Vec<f64>,
    /// Per second.
    pub speed: Vec<f64>,
    /// Per second squared.
    pub acceleration: Vec<f64>,
    /// State of friction, −1 to 1.
    pub friction: Vec<f64>,
    /// What is not known of that, 0 to 1.
    pub unknown: Vec<f64>,
}

/// Motion of a touch, sample by sample: positions without jumps of whole turns, and states of friction.
#[derive(Debug, Clone, Default)]
pub struct TouchMotion {
    times_s: Vec<f64>,
    positions: Vec<Vec<f64>>,
    friction: Vec<Vec<FrictionState>>,
    /// Samples without a time.
    untimed: bool,
}

impl TouchMotion {
    /// The motion of a touch, with friction that turns over these presliding distances (n_joints, rad).
    pub fn of(robot: &Robot, samples: &[Sample], presliding: &[f64]) -> Self {
        let mut motion = Self::default();
        samples.iter().for_each(|sample| motion.push(robot, sample, presliding));
        motion
    }

    /// Adds a sample.
    pub fn push(&mut self, robot: &Robot, sample: &Sample, presliding: &[f64]) {
        let n = sample.q.len();
        let (q, friction) = match (self.positions.last(), self.friction.last()) {
            (Some(last), Some(states)) => {
                let way = robot.difference(last, &sample.q);
                let mut states = states.clone();
                for (state, (way, presliding)) in states.iter_mut().zip(way.iter().zip(presliding))
                {
                    state.advance(*way, *presliding);
                }
                (last.iter().zip(way).map(|(last, way)| last + way).collect(), states)
            }
            _ => (sample.q.clone(), vec![FrictionState::default(); n]),
        };
        self.untimed |= sample.time_s.is_none();
        self.times_s.push(sample.time_s.unwrap_or(self.times_s.len() as f64));
        self.positions.push(q);
        self.friction.push(friction);
    }

    /// Forgets samples before a time, s.
    pub fn forget_before(&mut self, time_s: f64) {
        let old = self.times_s.partition_point(|time| *time < time_s);
        self.times_s.drain(..old);
        self.positions.drain(..old);
        self.friction.drain(..old);
    }

    /// Times of the samples, s.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// Whether speeds can be told: there is a clock, with at least four samples in a window of `2 · half_s`.
    pub fn is_timed(&self, half_s: f64) -> bool {
        let n = self.times_s.len();
        let span = self.times_s.last().unwrap_or(&0.0) - self.times_s.first().unwrap_or(&0.0);
        !self.untimed && n >= 4 && span > 0.0 && 2.0 * half_s * (n as f64 - 1.0) / span >= 3.0
    }

    /// States of the friction of a joint at the samples, with another presliding distance, rad.
    pub fn friction_of(&self, joint: usize, presliding: f64) -> Vec<FrictionState> {
        let mut state = FrictionState::default();
        let mut last = self.positions.first().map_or(0.0, |q| q[joint]);
        let each = self.positions.iter().map(|q| {
            state.advance(q[joint] - last, presliding);
            last = q[joint];
            state
        });
        each.collect()
    }

    /// The samples before and after a time, s, and how far it is from the first to the second, 0 to 1.
    ///
    /// # Panics
    ///
    /// If there are no samples.
    pub fn between(&self, time_s: f64) -> (usize, usize, f64) {
        let after = self.times_s.partition_point(|time| *time < time_s).min(self.times_s.len() - 1);
        let before = after.saturating_sub(1);
        let (from, to) = (self.times_s[before], self.times_s[after]);
        let part = if to > from { ((time_s - from) / (to - from)).clamp(0.0, 1.0) } else { 1.0 };
        (before, after, part)
    }

    /// The motion at a time, s, out of windows of `2 · half_s`.
    ///
    /// # Panics
    ///
    /// If there are no samples.
    pub fn at(&self, time_s: f64, half_s: f64, side: Side) -> Motion {
        let (before, after, part) = self.between(time_s);
        let mix = |a: f64, b: f64| a + part * (b - a);
        let states = self.friction[before].iter().zip(&self.friction[after]);
        let friction = states.clone().map(|(a, b)| mix(a.middle(), b.middle())).collect();
        let unknown = states.map(|(a, b)| mix(a.unknown(), b.unknown())).collect();
        if !self.is_timed(half_s) {
            let ends = self.positions[before].iter().zip(&self.positions[after]);
            let q: Vec<f64> = ends.map(|(a, b)| mix(*a, *b)).collect();
            let rest = vec![0.0; q.len()];
            return Motion { q, speed: rest.clone(), acceleration: rest, friction, unknown };
        }
        let fit = LocalPolynomial::new(&self.times_s, &self.positions, half_s, side).at(time_s);
        Motion { q: fit.value, speed: fit.first, acceleration: fit.second, friction, unknown }
    }
}

/// What a model makes of a sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Explained {
    /// τ_ext: what is measured less what the arm itself takes, n_joints, N·m.
    pub external: DVector<f64>,
    /// How uncertain that is, for each joint.
    pub factors: Vec<NoiseFactors>,
}

/// What the noise of a joint's torque grows with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseFactors {
    /// Position, rad.
    pub q: f64,
    /// How far friction is between two directions, 0 to 1.
    pub between: f64,
    /// What is not known of its state, 0 to 1.
    pub unknown: f64,
    /// Speed, rad/s.
    pub speed: f64,
    /// Torque that inertia takes, N·m.
    pub inertia: f64,
}

/// External torques of the samples of a touch, as far as a model knows the arm; with `causal`, out of what came before
/// each sample alone, for which the model is to be [`TorqueModel::causal`].
///
/// The tare is not taken off: the model has the bias, as far as it was the same when the arm was identified.
///
/// # Errors
///
/// If a sample does not fit the robot, or holds a torque that is no number of N·m.
///
/// # Panics
///
/// If the model was not checked for this robot ([`TorqueModel::check`]).
pub fn external_torques(
    robot: &Robot,
    model: &TorqueModel,
    config: &ExternalTorqueConfig,
    samples: &[Sample],
    causal: bool,
) -> Result<Vec<ExternalTorque>, TrackerError> {
    for sample in samples {
        let poses = robot.forward(&sample.q)?;
        config.untared(robot, &poses, &sample.tau)?;
    }
    let explained = explain(robot, model, config, (samples, &|_| true), causal)?;
    Ok(explained.iter().map(|(_, explained)| explained.with_std(model)).collect())
}

/// What a model makes of some samples of a touch, by number, and how uncertain that is.
///
/// # Errors and panics
///
/// As [`external_torques`].
pub fn explain(
    robot: &Robot,
    model: &TorqueModel,
    config: &ExternalTorqueConfig,
    (samples, which): (&[Sample], &dyn Fn(usize) -> bool),
    causal: bool,
) -> Result<Vec<(usize, Explained)>, TrackerError> {
    let presliding: Vec<f64> = model.joints.iter().map(|joint| joint.friction.presliding).collect();
    let motion = TouchMotion::of(robot, samples, &presliding);
    let parameters = model.check(robot).expect("models are checked before");
    let times = motion.times_s().iter().enumerate().filter(|(number, _)| which(*number));
    times
        .map(|(number, now_s)| {
            let side = if causal { Side::UpTo { now_s: *now_s } } else { Side::Around };
            let now = motion.at(now_s - model.delay_s, model.window_s, side);
            let tau = &samples[number].tau;
            Ok((number, model.explain(robot, &parameters, config, &now, tau)?))
        })
        .collect()
}

impl TorqueModel {
    /// What it makes of torques that are measured in a motion, with inertial parameters of [`TorqueModel::check`].
    pub(crate) fn explain(
        &self,
        robot: &Robot,
        parameters: &DVector<f64>,
        config: &ExternalTorqueConfig,
        motion: &Motion,
        tau: &[f64],
    ) -> Result<Explained, TrackerError> {
        let n = robot.n_joints();
        let poses = robot.forward(&motion.q)?;
        let rest = vec![0.0; n];
        let all = robot.regressor(&poses, &motion.speed, &motion.acceleration) * parameters;
        let at_rest = robot.regressor(&poses, &rest, &rest) * parameters;
        let sign = if config.torque_sign == TorqueSign::Minus { -1.0 } else { 1.0 };
        let mut external = DVector::zeros(n);
        let mut factors = Vec::with_capacity(n);
        for (j, joint) in self.joints.iter().enumerate() {
            let (q, speed) = (motion.q[j], motion.speed[j]);
            let (z, unknown) = (motion.friction[j], motion.unknown[j]);
            let inertia = all[j] - at_rest[j] + joint.rotor_inertia * motion.acceleration[j];
            let bias = joint.bias[0] + joint.bias[1] * q.cos() + joint.bias[2] * q.sin();
            external[j] = match config.gravity {
                Gravity::Included => {
                    let ripple: f64 = joint.ripple.iter().map(|own| own.torque(q, speed)).sum();
                    let taken = at_rest[j] + inertia + joint.friction.torque(z, speed) + ripple;
                    (sign * tau[j] - bias) / joint.gain + taken
                }
                // The robot has taken all of that off, as it knows it.
                Gravity::Removed => sign * tau[j],
            };
            factors.push(NoiseFactors {
                q,
                between: unknown.max(1.0 - z.abs()),
                unknown,
                speed,
                inertia,
            });
        }
        Ok(Explained { external, factors })
    }
}

impl Explained {
    /// With the standard deviation that the model says.
    pub fn with_std(&self, model: &TorqueModel) -> ExternalTorque {
        let std = self.factors.iter().zip(&model.joints).map(|(factors, joint)| {
            let &NoiseFactors { between, unknown, speed, inertia, .. } = factors;
            // A state that can be anything between two bounds is uniform between them.
            let friction = joint.friction.coulomb * unknown / 3_f64.sqrt();
            joint.noise.std(between, speed, inertia).hypot(friction)
        });
        let std = DVector::from_iterator(self.factors.len(), std);
        ExternalTorque { torque: self.external.clone(), std }
    }
}

/// External torques beside a running robot, sample by sample, out of what came before each.
#[derive(Debug, Clone)]
pub struct TorqueStream {
    arm: Arc<Arm>,
    model: TorqueModel,
    parameters: DVector<f64>,
    config: ExternalTorqueConfig,
    presliding: Vec<f64>,
    motion: TouchMotion,
}

impl TorqueStream {
    /// Of an arm that was identified, whose torques are logged as `config` says.
    ///
    /// # Errors
    ///
    /// A model of another arm, as a sentence.
    pub fn new(
        arm: Arc<Arm>,
        model: TorqueModel,
        config: ExternalTorqueConfig,
    ) -> Result<Self, String> {
        let parameters = model.check(&arm.robot)?;
        let model = model.causal();
        let presliding = model.joints.iter().map(|joint| joint.friction.presliding).collect();
        Ok(Self { arm, model, parameters, config, presliding, motion: TouchMotion::default() })
    }

    /// Forgets what came before: the next sample does not go on from it.
    pub fn begin(&mut self) {
        self.motion = TouchMotion::default();
    }

    /// The sample with its external torque, and the standard deviation of that, in place of the measured one.
    ///
    /// A clock that goes back begins anew.
    ///
    /// # Errors
    ///
    /// If the sample does not fit the robot, or holds a value that is no number; it is left out then.
    pub fn external(&mut self, sample: &Sample) -> Result<Sample, TrackerError> {
        let poses = self.arm.robot.forward(&sample.q)?;
        self.config.untared(&self.arm.robot, &poses, &sample.tau)?;
        let last_s = self.motion.times_s().last().copied();
        if let (Some(now_s), Some(last_s)) = (sample.time_s, last_s)
            && now_s < last_s
        {
            self.begin();
        }
        self.motion.push(&self.arm.robot, sample, &self.presliding);
        let now_s = *self.motion.times_s().last().expect("it was pushed above");
        let (model, robot) = (&self.model, &self.arm.robot);
        let side = Side::UpTo { now_s };
        let motion = self.motion.at(now_s - model.delay_s, model.window_s, side);
        let found = model.explain(robot, &self.parameters, &self.config, &motion, &sample.tau)?;
        let found = found.with_std(model);
        if sample.time_s.is_some() {
            // One more window is left for samples that are late.
            self.motion.forget_before(now_s - model.delay_s.abs() - 4.0 * model.window_s);
        }
        Ok(Sample {
            time_s: sample.time_s,
            q: sample.q.clone(),
            tau: found.torque.as_slice().to_vec(),
            tau_std: Some(found.std.as_slice().to_vec()),
        })
    }
}
