//! External torque: what the robot logs, with the sign of τ_ext and without gravity.
//!
//! `τ_ext = ± τ_measured − τ_gravity(q) − tare`. This module does all but the tare, which is
//! [`crate::tare`]'s. Friction and inertia of the arm are not modelled.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::robot::{Poses, Robot};
use crate::tare::Tare;
use crate::tracker::TrackerError;

/// Which way the logged torques count.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TorqueSign {
    /// What the environment and gravity exert on the joints (Kinova's sensors).
    #[default]
    Plus,
    /// What the motors exert: the opposite.
    Minus,
}

/// Whether the logged torques hold gravity.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Gravity {
    /// They do; the robot's masses say how much.
    #[default]
    Included,
    /// The robot has already taken it out (Franka's external torques).
    Removed,
}

/// How raw torques become external ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[non_exhaustive]
pub struct ExternalTorqueConfig {
    /// Sign of the logged torques.
    pub torque_sign: TorqueSign,
    /// Whether they hold gravity.
    pub gravity: Gravity,
    /// The torques are external ones, made with the model of an arm that was identified ([`crate::TorqueModel`]).
    pub identified: bool,
    /// Where the tare comes from.
    pub tare: Tare,
    /// The farthest a joint may be from where the touch began and still stand still, rad (m for a
    /// prismatic joint).
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
    /// Measured torque with the sign of τ_ext, less gravity at these poses and with its bias,
    /// n_joints, N·m.
    ///
    /// # Errors
    ///
    /// If there is not one torque a joint, or one is no number of N·m.
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

/// Torques from here on are broken sensors, N·m.
pub const MAX_TORQUE: f64 = 1e6;
