//! What an arm's torque sensors hold besides external torque, as `palpate identify` finds it.
//!
//! ```text
//! s·τ_measured(t) = gain · (τ_ext − Y(q, q̇, q̈) π − F(q̇))  + bias(q)        at the motion of t − delay
//! ```
//!
//! `s` is the sign of [`crate::ExternalTorqueConfig`], `Y π` the inverse dynamics of the robot
//! (`Robot::inverse_dynamics`), `F` friction and the inertia of the drives. Solved for `τ_ext`, this is an estimate of
//! the external torque at every sample; its standard deviation is that of the model's residual on motions that it
//! was not identified on.
//!
//! | file               | says                                                                  |
//! |--------------------|-----------------------------------------------------------------------|
//! | `friction`         | Coulomb, viscous and breakaway friction, with hysteresis at turns     |
//! | `local_polynomial` | position, speed and acceleration from logged positions                |
//! | `ripple`           | torque that comes back with the teeth of a gear, and shakes the arm   |
//! | `external`         | external torques of a touch, with their standard deviations           |
//! | `stamps`           | when joints were read, where a log's stamps are not that              |
//! | `alarm`            | when something is touched, at a rate of false alarms                  |

mod alarm;
mod external;
mod friction;
mod local_polynomial;
mod ripple;
mod stamps;

pub use alarm::Alarm;
pub use external::{
    Explained, ExternalTorque, Motion, NoiseFactors, TorqueStream, TouchMotion, explain,
    external_torques,
};
pub use friction::{FrictionState, JointFriction};
pub use local_polynomial::{Fit, LocalPolynomial, Window};
pub use ripple::{RIPPLE_COEFFICIENTS, Ripple};
pub use stamps::with_read_times;

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::robot::Robot;

/// Model of the torques that an arm measures, joint by joint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TorqueModel {
    /// How much later than positions torques are logged, s.
    pub delay_s: f64,
    /// Half of the time window out of which speeds and accelerations are computed, s.
    pub window_s: f64,
    /// In the robot's order.
    #[serde(rename = "joint")]
    pub joints: Vec<JointModel>,
    /// Ten inertial parameters for each body (`Robot::inertial_parameters`); empty: as in the URDF.
    #[serde(default)]
    pub inertial: Vec<f64>,
    /// What statistics of contact-free motion allow to detect.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alarm: Option<Alarm>,
    /// The same beside a running robot, where nothing is known of what comes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub causal: Option<Causal>,
}

/// Whether speeds at a sample come from what lies around it, or from what came before it alone.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Differentiation {
    /// From a window around each sample: of logs.
    #[default]
    Centred,
    /// From a window before each sample: beside a running robot.
    Causal,
}

/// What is different where speeds are known from the past alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Causal {
    /// Half of the time before now out of which speeds and accelerations are computed, s.
    pub window_s: f64,
    /// Noise of the residual, in the robot's order.
    pub noise: Vec<TorqueNoise>,
    /// What that allows to detect.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alarm: Option<Alarm>,
}

impl Causal {
    /// Whether it is one window and one noise for each joint.
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
    /// Measured torque where there is none, N·m; its parts with cos q and sin q.
    pub bias: [f64; 3],
    /// Inertia of the drive beyond the link's, seen at the joint, kg·m².
    pub rotor_inertia: f64,
    /// Friction.
    pub friction: JointFriction,
    /// Ripple of its gears, and what each joint feels of it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub ripple: Vec<Ripple>,
    /// Noise of the residual.
    pub noise: TorqueNoise,
}

/// Variance of a model's residual in a joint's external torque: a sum of squares, each of a part that grows with how
/// the joint moves.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TorqueNoise {
    /// Always, N·m.
    pub still: f64,
    /// While the joint turns round and its friction is between two directions, N·m.
    pub turning: f64,
    /// By speed, N·m·s/rad.
    pub by_speed: f64,
    /// By the part of the torque that inertia takes.
    pub by_inertia: f64,
}

impl TorqueNoise {
    /// Standard deviation, N·m, of a joint that is `turning` (0: its friction is that of a direction, to 1), at a speed
    /// and with a torque of inertia.
    pub fn std(&self, turning: f64, speed: f64, inertia: f64) -> f64 {
        let parts =
            [self.still, self.turning * turning, self.by_speed * speed, self.by_inertia * inertia];
        parts.iter().map(|part| part * part).sum::<f64>().sqrt()
    }
}

impl JointModel {
    /// What of it cannot be, as a sentence without its name.
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
    /// Whether it was identified on motor currents: most gains are far from 1, where those of torques are.
    pub fn is_of_currents(&self) -> bool {
        let far = self.joints.iter().filter(|joint| !(0.7..1.4).contains(&joint.gain)).count();
        2 * far > self.joints.len()
    }

    /// What is assumed of an arm that nobody has identified: masses as in its URDF, no friction, and a standard
    /// deviation that is a guess: 0.5 % of the joint's effort limit at rest, 1.5 % while it moves.
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

    /// The model with the window, noise and alarm that hold for a way of differentiation.
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

    /// Inertial parameters of the robot's bodies: the model's, or the robot's own.
    ///
    /// # Errors
    ///
    /// A model of another number of joints or bodies, or of joints with other names, or a number that cannot be, as a
    /// sentence.
    pub fn check(&self, robot: &Robot) -> Result<DVector<f64>, String> {
        let own: Vec<&str> = robot.joint_names().collect();
        let names: Vec<&str> = self.joints.iter().map(|joint| joint.name.as_str()).collect();
        if own != names {
            return Err(format!(
                "it is of an arm with the joints {}; the robot has {}",
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
            return Err("[causal] is to have one window and one noise for each joint".to_owned());
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
