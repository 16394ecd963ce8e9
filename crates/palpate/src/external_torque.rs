//! External torque: the logged torque with the sign of τ_ext, without gravity.
//!
//! `τ_ext = ± τ_measured − τ_gravity(q) − tare`. The tare is subtracted by [`crate::tare`]. Friction and inertia of the
//! arm are not modelled.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::robot::{Poses, Robot};
use crate::setting::SettingError;
use crate::tare::Tare;
use crate::tracker::TrackerError;

/// Sign convention of the logged torques.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TorqueSign {
    /// Torque that the environment and gravity exert on the joints (Kinova's sensors).
    #[default]
    Plus,
    /// Torque that the motors exert: the opposite sign.
    Minus,
}

/// Whether the logged torques include gravity.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Gravity {
    /// Included; it is computed from the robot's masses and subtracted.
    #[default]
    Included,
    /// The robot has already subtracted it (Franka's external torques).
    Removed,
}

/// How logged torques are converted to external torques.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct ExternalTorqueConfig {
    /// Sign of the logged torques.
    pub torque_sign: TorqueSign,
    /// Whether the logged torques include gravity.
    pub gravity: Gravity,
    /// Whether the torques are external torques already, computed with the model of an identified arm
    /// ([`crate::TorqueModel`]).
    pub identified: bool,
    /// Which frames give the tare.
    pub tare: Tare,
    /// The arm counts as standing still while no joint is farther than this from its position at the start of the
    /// touch, rad (m for a prismatic joint).
    pub still_rad: f64,
}

impl Default for ExternalTorqueConfig {
    fn default() -> Self {
        Self {
            torque_sign: TorqueSign::default(),
            gravity: Gravity::default(),
            identified: false,
            tare: Tare::default(),
            still_rad: 0.002,
        }
    }
}

impl ExternalTorqueConfig {
    /// Checks the settings that are numbers.
    ///
    /// # Errors
    ///
    /// Names the first setting that is out of its range.
    pub fn check(&self) -> Result<(), SettingError> {
        let check = SettingError::check;
        check("still_rad", self.still_rad, 0.0..=f64::MAX, "zero or more, and finite")?;
        let tare_frames =
            if let Tare::Frames(frames) = self.tare { f64::from(frames) } else { 1.0 };
        check("tare_frames", tare_frames, 1.0..=f64::MAX, "at least 1")
    }

    /// Measured torque with the sign of τ_ext, minus gravity at these poses but not minus the tare, n_joints, N·m.
    ///
    /// # Errors
    ///
    /// If there is not one torque for each joint, or a torque is NaN or beyond ±[`MAX_TORQUE`].
    pub fn untared(
        &self,
        robot: &Robot,
        poses: &Poses,
        tau: &[f64],
    ) -> Result<DVector<f64>, TrackerError> {
        if tau.len() != robot.n_joints() {
            return Err(TrackerError::TorqueCount { expected: robot.n_joints(), got: tau.len() });
        }
        if let Some((joint, &found)) = robot
            .joint_names()
            .zip(tau)
            .find(|(_, torque)| !(-MAX_TORQUE..=MAX_TORQUE).contains(*torque))
        {
            return Err(TrackerError::Torque { joint: joint.to_owned(), found });
        }
        let mut untared = DVector::from_column_slice(tau);
        if self.torque_sign == TorqueSign::Minus {
            untared.neg_mut();
        }
        if self.gravity == Gravity::Included {
            untared -= robot.gravity_torque(poses);
        }
        Ok(untared)
    }
}

/// Larger torques are taken for faults of the sensor and refused, N·m.
pub const MAX_TORQUE: f64 = 1e6;
