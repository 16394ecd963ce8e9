//! Model of an arm's measured torques besides external torque, as found by `palpate identify`.
//!
//! ```text
//! s·τ_measured(t) = gain · (τ_ext − Y(q, q̇, q̈) π − F(q̇))  + bias(q)        at the motion of t − delay
//! ```
//!
//! `s` is the sign of [`crate::ExternalTorqueConfig`], `Y π` the inverse dynamics of the robot
//! (`Robot::inverse_dynamics`), `F` friction and the inertia of the drives. Solved for `τ_ext`, this is an estimate of
//! the external torque at every sample; its standard deviation is that of the model's residual on held-out motions.
//!
//! | file               | contents                                                              |
//! |--------------------|-----------------------------------------------------------------------|
//! | `friction`         | Coulomb, viscous and breakaway friction, with hysteresis at reversals |
//! | `local_polynomial` | position, speed and acceleration from logged positions                |
//! | `ripple`           | torque that repeats with the teeth of a gear                          |
//! | `external`         | external torques of a touch, with their standard deviations           |
//! | `stamps`           | times at which joints were read, if time stamps differ from them      |
//! | `alarm`            | contact detection at a given rate of false alarms                     |
//! | `wrench`           | wrench at a link that explains an external torque                     |

mod alarm;
mod external;
mod friction;
mod local_polynomial;
mod ripple;
mod stamps;
mod wrench;

pub use alarm::FalseAlarmModel;
pub use external::{
    ExternalTorque, JointMotion, ModelResidual, NoiseFactors, TorqueStream, TouchMotion,
    external_torques, model_residuals,
};
pub use friction::{FrictionState, JointFriction};
pub use local_polynomial::{LocalPolynomial, PolynomialFit, Window};
pub use ripple::{RIPPLE_COEFFICIENTS, Ripple};
pub use stamps::with_read_times;
pub use wrench::LinkWrench;

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::robot::Robot;

/// Model of the torques that an arm measures, joint by joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TorqueModel {
    /// Delay of the torques relative to the positions in a log, s.
    pub delay_s: f64,
    /// Half of the time window from which speeds and accelerations are computed, s.
    pub window_s: f64,
    /// The joints, in the robot's order.
    #[serde(rename = "joint")]
    pub joints: Vec<JointModel>,
    /// Ten inertial parameters for each body (`Robot::inertial_parameters`); empty: as in the URDF.
    #[serde(default)]
    pub inertial: Vec<f64>,
    /// Statistics of contact-free motion, for contact detection.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alarm: Option<FalseAlarmModel>,
    /// What differs for a running robot, where later samples are not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub causal: Option<Causal>,
}

/// Whether speeds at a sample are computed from the samples around it, or only from those up to it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Differentiation {
    /// From a window around each sample: for logs.
    #[default]
    Centred,
    /// From a window before each sample: for a running robot.
    Causal,
}

/// What differs if speeds at a sample are computed only from the samples up to it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Causal {
    /// Half of the time window before the present from which speeds and accelerations are computed, s.
    pub window_s: f64,
    /// Noise of the residual, in the robot's order.
    pub noise: Vec<TorqueNoise>,
    /// Statistics of contact-free motion with this noise, for contact detection.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alarm: Option<FalseAlarmModel>,
}

impl Causal {
    /// Whether it has a valid window, and a valid noise for each joint.
    fn fits(&self, joints: usize) -> bool {
        let is = |own: f64, least: f64| own >= least && own.is_finite();
        let is_noise = |own: &TorqueNoise| {
            let parts = [own.turning, own.by_speed, own.by_inertia];
            is(own.still, 1e-12) && parts.iter().all(|own| is(*own, 0.0))
        };
        let has_window = self.window_s > 0.0 && self.window_s < 10.0;
        has_window && self.noise.len() == joints && self.noise.iter().all(is_noise)
    }
}

/// The model of one joint's torque.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointModel {
    /// Name of the joint.
    pub name: String,
    /// Measured over true torque; where a drive's current is logged, the inverse of its torque constant.
    pub gain: f64,
    /// Measured torque at zero torque, N·m: a constant, and the factors of cos q and sin q.
    pub bias: [f64; 3],
    /// Inertia of the drive, in addition to that of the links, at the joint, kg·m².
    pub rotor_inertia: f64,
    /// Friction.
    pub friction: JointFriction,
    /// Ripple of its gears, in the torques of all joints.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ripple: Vec<Ripple>,
    /// Noise of the residual.
    pub noise: TorqueNoise,
}

/// Variance of a model's residual in a joint's external torque: the sum of the squares of these parts, which depend on
/// the motion of the joint.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TorqueNoise {
    /// Constant part, N·m.
    pub still: f64,
    /// Part while the joint reverses and its friction is between the two directions, N·m.
    pub turning: f64,
    /// Part in proportion to the speed, N·m·s/rad.
    pub by_speed: f64,
    /// Part in proportion to the torque of inertia, without unit.
    pub by_inertia: f64,
}

impl TorqueNoise {
    /// Standard deviation, N·m, at a speed, rad/s, and a torque of inertia, N·m; `turning` is 0 if friction is that of
    /// one direction, up to 1 in a reversal.
    pub fn std(&self, turning: f64, speed: f64, inertia: f64) -> f64 {
        let parts =
            [self.still, self.turning * turning, self.by_speed * speed, self.by_inertia * inertia];
        parts.iter().map(|part| part * part).sum::<f64>().sqrt()
    }
}

impl JointModel {
    /// Checks its numbers; the error is a sentence without the name of the joint.
    fn check(&self, joints: usize) -> Result<(), String> {
        let Self { gain, bias, rotor_inertia, friction, noise, ripple, .. } = self;
        let is = |value: f64, wanted: bool| value.is_finite() && wanted;
        let at_least_zero = [
            ("rotor_inertia", *rotor_inertia),
            ("coulomb", friction.coulomb),
            ("viscous", friction.viscous),
            ("presliding", friction.presliding),
            ("turning", noise.turning),
            ("by_speed", noise.by_speed),
            ("by_inertia", noise.by_inertia),
        ];
        if let Some((key, value)) = at_least_zero.iter().find(|(_, v)| !is(*v, *v >= 0.0)) {
            return Err(format!("{key} is {value}; wanted 0 or more"));
        }
        let above_zero = [("still", noise.still), ("stribeck", friction.stribeck)];
        if let Some((key, value)) = above_zero.iter().find(|(_, v)| !is(*v, *v > 0.0)) {
            return Err(format!("{key} is {value}; wanted more than 0"));
        }
        if !is(*gain, gain.abs() > 1e-6) {
            return Err(format!("gain is {gain}; wanted a number that is not 0"));
        }
        let numbers = [friction.asymmetry, friction.breakaway, bias[0], bias[1], bias[2]];
        if let Some(number) = numbers.iter().find(|number| !number.is_finite()) {
            return Err(format!("found {number}; wanted finite numbers"));
        }
        ripple.iter().try_for_each(|own| own.check(joints))
    }
}

impl TorqueModel {
    /// Whether it was identified from motor currents: most gains are far from 1, unlike those of torques.
    pub fn is_of_currents(&self) -> bool {
        let far = self.joints.iter().filter(|joint| !(0.7..1.4).contains(&joint.gain)).count();
        2 * far > self.joints.len()
    }

    /// Default model of an arm that was not identified: masses as in its URDF, no friction, and a guessed standard
    /// deviation: 0.5 % of the joint's effort limit at rest, 1.5 % while it moves.
    pub fn of_urdf(robot: &Robot) -> Self {
        let joints = robot.joints().iter().map(|joint| {
            let effort = joint.effort.unwrap_or(40.0);
            JointModel {
                name: joint.name.clone(),
                gain: 1.0,
                bias: [0.0; 3],
                rotor_inertia: 0.0,
                friction: JointFriction::default(),
                ripple: Vec::new(),
                noise: TorqueNoise {
                    still: 0.005 * effort,
                    turning: 0.015 * effort,
                    by_speed: 0.015 * effort,
                    by_inertia: 0.1,
                },
            }
        });
        Self {
            delay_s: 0.0,
            window_s: 0.1,
            joints: joints.collect(),
            inertial: vec![],
            alarm: None,
            causal: None,
        }
    }

    /// The model with the window, noise and alarm for this kind of differentiation.
    #[must_use]
    pub fn for_differentiation(mut self, differentiation: Differentiation) -> Self {
        if differentiation == Differentiation::Causal
            && let Some(Causal { window_s, noise, alarm }) = self.causal.take()
        {
            (self.window_s, self.alarm) = (window_s, alarm);
            for (joint, noise) in self.joints.iter_mut().zip(noise) {
                joint.noise = noise;
            }
        }
        self
    }

    /// Checks the model for a robot, and returns the inertial parameters of its bodies: the model's, or else the
    /// robot's.
    ///
    /// # Errors
    ///
    /// A model of another number of joints or bodies, or of joints with other names, or an invalid number, as a
    /// sentence.
    pub fn check(&self, robot: &Robot) -> Result<DVector<f64>, String> {
        let own: Vec<&str> = robot.joint_names().collect();
        let names: Vec<&str> = self.joints.iter().map(|joint| joint.name.as_str()).collect();
        if own != names {
            return Err(format!(
                "it belongs to an arm with the joints {}; the robot has {}",
                names.join(", "),
                own.join(", ")
            ));
        }
        for joint in &self.joints {
            joint.check(own.len()).map_err(|what| format!("joint `{}`: {what}", joint.name))?;
        }
        if self.delay_s.is_nan() || self.delay_s.abs() >= 1.0 {
            return Err(format!("delay_s is {}; wanted less than 1 s", self.delay_s));
        }
        if self.causal.as_ref().is_some_and(|causal| !causal.fits(self.joints.len())) {
            return Err("[causal] must have one window, and one noise for each joint".to_owned());
        }
        let alarms = [self.alarm, self.causal.as_ref().and_then(|causal| causal.alarm)];
        if alarms.iter().flatten().any(|alarm| !alarm.is_sound()) {
            return Err("[alarm] holds a number that is not finite, or below 0".to_owned());
        }
        if !(self.window_s > 0.0 && self.window_s < 10.0) {
            return Err(format!(
                "window_s is {}; wanted more than 0 and less than 10 s",
                self.window_s
            ));
        }
        let of_robot = robot.inertial_parameters();
        match self.inertial.len() {
            0 => Ok(of_robot),
            n if n == of_robot.len() && self.inertial.iter().all(|own| own.is_finite()) => {
                Ok(DVector::from_column_slice(&self.inertial))
            }
            n => Err(format!("inertial has {n} numbers; wanted {} finite ones", of_robot.len())),
        }
    }
}
