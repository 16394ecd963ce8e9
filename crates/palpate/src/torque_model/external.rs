//! External torque of every sample of a touch: the measured torque minus that of the arm itself, by the model.
//!
//! The motion is computed at the time of the torque minus the delay. For a running robot the window ends at the
//! present, so a part of it may be later than that time. If a log has no times, or too few samples in a window, speeds
//! are not known: gravity, bias and Coulomb friction are subtracted, and the standard deviation covers the rest.

use std::sync::Arc;

use nalgebra::DVector;

use super::{
    Differentiation, FrictionState, LocalPolynomial, PolynomialFit, TorqueModel, TorqueNoise,
    Window, with_read_times,
};
use crate::arm::Arm;
use crate::external_torque::{ExternalTorqueConfig, Gravity, TorqueSign};
use crate::robot::Robot;
use crate::tracker::{Sample, TrackerError};

/// External torque at a sample.
#[derive(Debug, Clone, PartialEq)]
pub struct ExternalTorque {
    /// Torque that the environment exerts on the joints, n_joints, N·m.
    pub torque: DVector<f64>,
    /// Its standard deviation, n_joints, N·m.
    pub std: DVector<f64>,
}

/// Motion of the joints at a time, with the states of their friction.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointMotion {
    /// Positions, n_joints, rad or m.
    pub q: Vec<f64>,
    /// Speeds, n_joints, rad/s or m/s.
    pub speed: Vec<f64>,
    /// Accelerations, n_joints, rad/s² or m/s².
    pub acceleration: Vec<f64>,
    /// States of friction, −1 to 1.
    pub friction: Vec<f64>,
    /// Uncertainty of these states, 0 to 1.
    pub unknown: Vec<f64>,
    /// Possible errors of speeds and accelerations where samples are on one side only: [`PolynomialFit::doubt`].
    pub doubt: Option<[Vec<f64>; 2]>,
}

/// Motion of a touch, sample by sample: positions without jumps of whole turns, and states of friction.
#[derive(Debug, Clone, Default)]
pub struct TouchMotion {
    times_s: Vec<f64>,
    positions: Vec<Vec<f64>>,
    friction: Vec<Vec<FrictionState>>,
    /// The presliding distance of each joint, rad.
    presliding: Vec<f64>,
    /// Whether samples are counted instead of timed.
    untimed: bool,
}

impl TouchMotion {
    /// An empty motion, of joints with these presliding distances (n_joints, rad).
    pub(crate) fn new(presliding: Vec<f64>) -> Self {
        Self { presliding, ..Self::default() }
    }

    /// The motion of a touch; `presliding` are the presliding distances of the joints (n_joints, rad). If all times are
    /// equal, they are not used.
    pub fn of(robot: &Robot, samples: &[Sample], presliding: Vec<f64>) -> Self {
        let mut motion = Self::new(presliding);
        samples.iter().for_each(|sample| motion.push(robot, sample));
        if samples.len() > 1 && motion.times_s.first() == motion.times_s.last() {
            motion.count_samples();
        }
        motion
    }

    /// Replaces the times of samples by their numbers.
    fn count_samples(&mut self) {
        self.untimed = true;
        let numbered = self.times_s.iter_mut().enumerate();
        numbered.for_each(|(number, time_s)| *time_s = number as f64);
    }

    /// Adds a sample. If it has no time, or an earlier one than the last sample, times are replaced by sample numbers.
    pub fn push(&mut self, robot: &Robot, sample: &Sample) {
        let q = match self.positions.last() {
            Some(last) => {
                let way = robot.difference(last, &sample.q);
                last.iter().zip(way).map(|(last, way)| last + way).collect()
            }
            None => sample.q.clone(),
        };
        let last_s = self.times_s.last().copied();
        if !self.untimed
            && sample.time_s.is_none_or(|now_s| last_s.is_some_and(|last_s| now_s < last_s))
        {
            self.count_samples();
        }
        let counted = self.times_s.last().map_or(0.0, |last| last + 1.0);
        self.times_s.push(sample.time_s.filter(|_| !self.untimed).unwrap_or(counted));
        self.friction.push(vec![FrictionState::default(); q.len()]);
        self.positions.push(q);
        // Whether the joint reversed before the last sample is known only now.
        let n = self.positions.len();
        for k in n.saturating_sub(2).max(1)..n {
            self.friction[k] = (0..sample.q.len())
                .map(|j| {
                    self.moved((k - 1, k, 1.0), j, (self.friction[k - 1][j], self.presliding[j]))
                })
                .collect();
        }
    }

    /// Forgets samples before a time, s, except for the last four; without times, all except the last four.
    pub(crate) fn forget_before(&mut self, time_s: f64) {
        let n = self.times_s.len();
        let old =
            if self.untimed { n } else { self.times_s.partition_point(|time| *time < time_s) };
        let old = old.min(n.saturating_sub(4));
        self.times_s.drain(..old);
        self.positions.drain(..old);
        self.friction.drain(..old);
    }

    /// Times of the samples, s.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// Times of the samples, s, if they have valid ones.
    pub(super) fn clock(&self) -> Option<&[f64]> {
        (!self.untimed).then_some(&self.times_s)
    }

    /// Positions of the samples, n_joints each, rad or m, without jumps of whole turns.
    pub(super) fn positions(&self) -> &[Vec<f64>] {
        &self.positions
    }

    /// Whether speeds can be determined: samples have times, with at least four samples in a window of `2 · half_s`.
    pub fn is_timed(&self, half_s: f64) -> bool {
        let n = self.times_s.len();
        let span = self.times_s.last().unwrap_or(&0.0) - self.times_s.first().unwrap_or(&0.0);
        !self.untimed && n >= 4 && span > 0.0 && 2.0 * half_s * (n as f64 - 1.0) / span >= 3.0
    }

    /// States of the friction of a joint at the samples, with another presliding distance, rad.
    pub fn friction_of(&self, joint: usize, presliding: f64) -> Vec<FrictionState> {
        let mut state = FrictionState::default();
        let each = (0..self.positions.len()).map(|k| {
            if k > 0 {
                state = self.moved((k - 1, k, 1.0), joint, (state, presliding));
            }
            state
        });
        each.collect()
    }

    /// State of the friction of a joint at a time, s, from its states of [`Self::friction_of`].
    ///
    /// # Panics
    ///
    /// If there are no samples.
    pub fn friction_at(
        &self,
        time_s: f64,
        joint: usize,
        (states, presliding): (&[FrictionState], f64),
    ) -> FrictionState {
        let place = self.between(time_s);
        self.moved(place, joint, (states[place.0], presliding))
    }

    /// The state of friction after a part (0 to 1) of the motion of a joint from one sample to the next.
    fn moved(
        &self,
        (before, after, part): (usize, usize, f64),
        joint: usize,
        (mut state, presliding): (FrictionState, f64),
    ) -> FrictionState {
        if after > before {
            let at = |k: usize| self.positions[k.min(self.positions.len() - 1)][joint];
            let four = [at(before.saturating_sub(1)), at(before), at(after), at(after + 1)];
            state.follow(four, part, presliding);
        }
        state
    }

    /// The samples before and after a time, s, and where the time is between them, 0 to 1.
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

    /// The motion at a time, s, from windows of `2 · half_s`.
    ///
    /// # Panics
    ///
    /// If there are no samples.
    pub fn at(&self, time_s: f64, half_s: f64, window: Window) -> JointMotion {
        let (before, after, part) = self.between(time_s);
        let mix = |a: f64, b: f64| a + part * (b - a);
        let states: Vec<FrictionState> = (self.presliding.iter().enumerate())
            .map(|(j, presliding)| {
                self.moved((before, after, part), j, (self.friction[before][j], *presliding))
            })
            .collect();
        let friction = states.iter().map(|state| state.middle()).collect();
        let unknown = states.iter().map(|state| state.unknown()).collect();
        if !self.is_timed(half_s) {
            let ends = self.positions[before].iter().zip(&self.positions[after]);
            let q: Vec<f64> = ends.map(|(a, b)| mix(*a, *b)).collect();
            let rest = vec![0.0; q.len()];
            // A stream that has just begun. If samples are too far apart for speeds, the noise covers the error.
            let is_new = !self.untimed && self.times_s.len() < 4;
            let doubt = is_new.then(|| [(); 2].map(|()| vec![f64::INFINITY; q.len()]));
            let (speed, acceleration) = (rest.clone(), rest);
            return JointMotion { q, speed, acceleration, friction, unknown, doubt };
        }
        let fit = LocalPolynomial::new(&self.times_s, &self.positions, half_s, window).at(time_s);
        let PolynomialFit { value: q, first: speed, second: acceleration, doubt } = fit;
        JointMotion { q, speed, acceleration, friction, unknown, doubt }
    }
}

/// External torque of a sample by a model.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelResidual {
    /// τ_ext: the measured torque minus that of the arm itself, n_joints, N·m.
    pub external: DVector<f64>,
    /// What its noise depends on, for each joint.
    pub factors: Vec<NoiseFactors>,
}

/// What the noise of a joint's torque depends on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseFactors {
    /// Position, rad.
    pub q: f64,
    /// How far friction is from that of a direction, 0 (sliding) to 1.
    pub turning: f64,
    /// Half of the distance between the bounds of its state, 0 to 1.
    pub unknown: f64,
    /// Speed, rad/s.
    pub speed: f64,
    /// Torque of inertia, N·m.
    pub inertia: f64,
    /// Possible error of the torque of the arm's motion at the beginning and the end of a log, N·m.
    pub at_end: f64,
}

impl NoiseFactors {
    /// Standard deviation of a joint's torque if the state of friction is known, N·m.
    pub fn std(&self, noise: &TorqueNoise) -> f64 {
        noise.std(self.turning, self.speed, self.inertia).hypot(self.at_end)
    }
}

/// Top speed of a joint without one in the URDF, rad/s or m/s.
const FASTEST: f64 = 3.0;

impl JointMotion {
    /// If speeds and accelerations are in doubt, those that may be true instead. The doubt is limited to what a joint
    /// can do: its top speed, reached within a window.
    fn doubted(&self, robot: &Robot, half_s: f64) -> Option<[Vec<f64>; 2]> {
        let [speed, acceleration] = self.doubt.as_ref()?;
        let most = |j: usize| robot.joints()[j].velocity.unwrap_or(FASTEST);
        let other = |own: &[f64], doubt: &[f64], per_s: f64| {
            let own = own.iter().zip(doubt).enumerate();
            own.map(|(j, (own, doubt))| own + doubt.clamp(-most(j) * per_s, most(j) * per_s))
                .collect()
        };
        let speed = other(&self.speed, speed, 1.0);
        Some([speed, other(&self.acceleration, acceleration, 0.5 / half_s)])
    }
}

/// External torques of the samples of a touch, by a model of the arm.
///
/// No tare is subtracted: the model includes the bias, as it was when the arm was identified. With
/// [`Differentiation::Centred`], time stamps that clearly differ from the times at which the joints were read are
/// corrected ([`with_read_times`]).
///
/// # Errors
///
/// If a sample does not fit the robot, or has an invalid torque; or if the model is of another arm.
pub fn external_torques(
    robot: &Robot,
    model: &TorqueModel,
    config: &ExternalTorqueConfig,
    samples: &[Sample],
    differentiation: Differentiation,
) -> Result<Vec<ExternalTorque>, TrackerError> {
    let model = model.clone().for_differentiation(differentiation);
    for sample in samples {
        let poses = robot.forward(&sample.q)?;
        config.untared(robot, &poses, &sample.tau)?;
    }
    let timed = match differentiation {
        Differentiation::Centred => with_read_times(robot, samples),
        Differentiation::Causal => None,
    };
    let samples = timed.as_deref().unwrap_or(samples);
    let explained = model_residuals(robot, &model, config, (samples, &|_| true), differentiation)?;
    Ok(explained.iter().map(|(_, explained)| explained.with_std(&model)).collect())
}

/// External torques of some samples of a touch, each with its number, by a model for this kind of differentiation
/// ([`TorqueModel::for_differentiation`]); `which` selects the samples.
///
/// # Errors
///
/// As [`external_torques`].
pub fn model_residuals(
    robot: &Robot,
    model: &TorqueModel,
    config: &ExternalTorqueConfig,
    (samples, which): (&[Sample], &dyn Fn(usize) -> bool),
    differentiation: Differentiation,
) -> Result<Vec<(usize, ModelResidual)>, TrackerError> {
    let presliding: Vec<f64> = model.joints.iter().map(|joint| joint.friction.presliding).collect();
    let parameters = model.check(robot).map_err(TrackerError::TorqueModel)?;
    let motion = TouchMotion::of(robot, samples, presliding);
    let times = motion.times_s().iter().enumerate().filter(|(number, _)| which(*number));
    times
        .map(|(number, now_s)| {
            let window = match differentiation {
                Differentiation::Centred => Window::Centred,
                Differentiation::Causal => Window::Causal { now_s: *now_s },
            };
            let now = motion.at(now_s - model.delay_s, model.window_s, window);
            let tau = &samples[number].tau;
            Ok((number, model.explain(robot, &parameters, config, &now, tau)?))
        })
        .collect()
}

impl TorqueModel {
    /// External torque from the measured torque `tau` in a motion; `parameters` are those of [`TorqueModel::check`].
    pub(crate) fn explain(
        &self,
        robot: &Robot,
        parameters: &DVector<f64>,
        config: &ExternalTorqueConfig,
        motion: &JointMotion,
        tau: &[f64],
    ) -> Result<ModelResidual, TrackerError> {
        let n = robot.n_joints();
        let poses = robot.forward(&motion.q)?;
        let rest = vec![0.0; n];
        let all = robot.regressor(&poses, &motion.speed, &motion.acceleration) * parameters;
        let at_rest = robot.regressor(&poses, &rest, &rest) * parameters;
        let sign = if config.torque_sign == TorqueSign::Minus { -1.0 } else { 1.0 };
        let mut external = DVector::zeros(n);
        let mut factors = Vec::with_capacity(n);
        let is_modelled = config.gravity == Gravity::Included;
        let moved = motion.doubted(robot, self.window_s).filter(|_| is_modelled).map(
            |[speed, acceleration]| {
                let all = robot.regressor(&poses, &speed, &acceleration) * parameters;
                (all, speed, acceleration)
            },
        );
        let mut ripple = vec![0.0; n];
        for (j, joint) in self.joints.iter().enumerate() {
            joint
                .ripple
                .iter()
                .for_each(|own| own.add_to(&mut ripple, motion.q[j], motion.speed[j]));
        }
        for (j, joint) in self.joints.iter().enumerate() {
            let (q, speed) = (motion.q[j], motion.speed[j]);
            let (z, unknown) = (motion.friction[j], motion.unknown[j]);
            let inertia = all[j] - at_rest[j] + joint.rotor_inertia * motion.acceleration[j];
            let bias = joint.bias[0] + joint.bias[1] * q.cos() + joint.bias[2] * q.sin();
            external[j] = match config.gravity {
                Gravity::Included => {
                    let taken = at_rest[j] + inertia + joint.friction.torque(z, speed) + ripple[j];
                    (sign * tau[j] - bias) / joint.gain + taken
                }
                // The robot has subtracted all of that by its own model.
                Gravity::Removed => sign * tau[j],
            };
            let at_end = moved.as_ref().map_or(0.0, |(other, other_speed, other_acceleration)| {
                let rotor = joint.rotor_inertia * (other_acceleration[j] - motion.acceleration[j]);
                let friction =
                    joint.friction.torque(z, other_speed[j]) - joint.friction.torque(z, speed);
                (other[j] - all[j] + rotor + friction).abs()
            });
            let turning = unknown.max(1.0 - z.abs());
            factors.push(NoiseFactors { q, turning, unknown, speed, inertia, at_end });
        }
        Ok(ModelResidual { external, factors })
    }
}

impl ModelResidual {
    /// Adds the standard deviation by the model.
    pub(crate) fn with_std(&self, model: &TorqueModel) -> ExternalTorque {
        let std = self.factors.iter().zip(&model.joints).map(|(factors, joint)| {
            // An unknown state is uniform between its bounds.
            let friction = joint.friction.coulomb * factors.unknown / 3_f64.sqrt();
            factors.std(&joint.noise).hypot(friction)
        });
        let std = DVector::from_iterator(self.factors.len(), std);
        ExternalTorque { torque: self.external.clone(), std }
    }
}

/// External torques of a running robot, sample by sample, each from the samples so far.
#[derive(Debug, Clone)]
pub struct TorqueStream {
    arm: Arc<Arm>,
    model: TorqueModel,
    parameters: DVector<f64>,
    config: ExternalTorqueConfig,
    motion: TouchMotion,
}

impl TorqueStream {
    /// For an identified arm, whose torques have the convention of `config`.
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
        let model = model.for_differentiation(Differentiation::Causal);
        let presliding = model.joints.iter().map(|joint| joint.friction.presliding).collect();
        let motion = TouchMotion::new(presliding);
        Ok(Self { arm, model, parameters, config, motion })
    }

    /// Forgets all samples: the next one starts a new motion.
    pub fn begin(&mut self) {
        self.motion = TouchMotion::new(std::mem::take(&mut self.motion.presliding));
    }

    /// The sample with its external torque and the standard deviation of that, instead of the measured torque.
    ///
    /// If the time goes back, a new motion starts.
    ///
    /// # Errors
    ///
    /// If the sample does not fit the robot, or has an invalid value; it is then ignored.
    pub fn external(&mut self, sample: &Sample) -> Result<Sample, TrackerError> {
        let poses = self.arm.robot.forward(&sample.q)?;
        self.config.untared(&self.arm.robot, &poses, &sample.tau)?;
        let last_s = self.motion.times_s().last().copied();
        if let (Some(now_s), Some(last_s)) = (sample.time_s, last_s)
            && now_s < last_s
        {
            self.begin();
        }
        self.motion.push(&self.arm.robot, sample);
        let now_s = *self.motion.times_s().last().expect("it was pushed above");
        let (model, robot) = (&self.model, &self.arm.robot);
        let window = Window::Causal { now_s };
        let motion = self.motion.at(now_s - model.delay_s, model.window_s, window);
        let found = model.explain(robot, &self.parameters, &self.config, &motion, &sample.tau)?;
        let found = found.with_std(model);
        // One more window is kept for late samples.
        self.motion.forget_before(now_s - model.delay_s.abs() - 4.0 * model.window_s);
        Ok(Sample {
            time_s: sample.time_s,
            q: sample.q.clone(),
            tau: found.torque.as_slice().to_vec(),
            tau_std: Some(found.std.as_slice().to_vec()),
        })
    }
}
