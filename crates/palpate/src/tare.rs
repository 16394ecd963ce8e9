//! The tare: the mean torque of a touch before anything is touched.
//!
//! Sensors drift between touches, so every touch has its own tare: the mean of the logged torque, with the sign of
//! τ_ext and without gravity, over the contact-free frames at its start. A frame counts as contact-free while the arm
//! stands still, or while the simulator finds no contact with the lattice; the contact-free start ends at the first
//! frame with neither. Without such a start, torques from which the robot has subtracted gravity are used without a
//! tare; other torques are refused. For an identified arm, whose torques have standard deviations, the start also ends
//! at the first torque that its standard deviation does not explain.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::external_torque::{ExternalTorqueConfig, Gravity};
use crate::robot::Robot;
use crate::tracker::TrackerError;

/// Which frames of a touch give its tare.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tare {
    /// The contact-free start, detected automatically.
    #[default]
    Auto,
    /// The first frames, as many as given.
    Frames(u32),
    /// No tare: the torques are external torques already.
    None,
}

/// Least number of contact-free frames for a tare.
pub const MIN_TARE_FRAMES: u32 = 5;

/// Largest torque of an identified arm without contact, in standard deviations.
const MAX_STDS: f64 = 4.0;

/// Whether a frame belongs to the contact-free start of a touch, given that all frames before it do: the arm still
/// stands where the touch began, or touches no point of the lattice.
///
/// The joint positions at the start of the touch and now are n_joints each, rad or m, as is `still_rad`.
pub fn is_contact_free(
    robot: &Robot,
    (q_start, q): (&[f64], &[f64]),
    still_rad: f64,
    touches: bool,
) -> bool {
    !touches || robot.difference(q_start, q).iter().all(|way| way.abs() <= still_rad)
}

/// Whether the torques of an identified arm are no larger than the residual of its model: the load of an arm that
/// stands still must not become the tare.
fn is_explained(untared: &DVector<f64>, std: &[f64]) -> bool {
    untared.iter().zip(std).all(|(torque, std)| torque.abs() <= MAX_STDS * std)
}

/// The tare of one touch, while it is computed and after.
#[derive(Debug, Clone)]
pub(crate) struct TouchTare {
    /// Joint positions at the start of the touch, n_joints.
    q_start: Vec<f64>,
    state: State,
}

#[derive(Debug, Clone)]
enum State {
    /// Being computed: the sum over the frames so far.
    Open {
        sum: DVector<f64>,
        frames: u32,
    },
    Known(DVector<f64>),
}

impl TouchTare {
    /// The tare of a touch that begins at these joint positions.
    pub(crate) fn begin(q_start: &[f64], tare: Tare) -> Self {
        let sum = DVector::zeros(q_start.len());
        let state = match tare {
            Tare::None => State::Known(sum),
            Tare::Auto | Tare::Frames(_) => State::Open { sum, frames: 0 },
        };
        Self { q_start: q_start.to_vec(), state }
    }

    /// The tare, n_joints, N·m, once it is known.
    pub(crate) fn known(&self) -> Option<&DVector<f64>> {
        match &self.state {
            State::Known(tare) => Some(tare),
            State::Open { .. } => None,
        }
    }

    /// Adds a frame to the tare and returns `None`; or, once the tare is known, subtracts it and returns τ_ext,
    /// n_joints, N·m.
    ///
    /// `in_contact`: whether the arm touches any point of the lattice.
    ///
    /// # Errors
    ///
    /// If the contact-free start has too few frames, and the torques include gravity.
    pub(crate) fn subtract(
        &mut self,
        (robot, config): (&Robot, &ExternalTorqueConfig),
        (q, in_contact, tau_std): (&[f64], bool, Option<&[f64]>),
        untared: &DVector<f64>,
    ) -> Result<Option<DVector<f64>>, TrackerError> {
        if let State::Open { sum, frames } = &mut self.state {
            let goes_on = match config.tare {
                Tare::Frames(wanted) => *frames < wanted,
                _ => {
                    is_contact_free(robot, (&self.q_start, q), config.still_rad, in_contact)
                        && tau_std.is_none_or(|std| is_explained(untared, std))
                }
            };
            if goes_on {
                *sum += untared;
                *frames += 1;
                return Ok(None);
            }
            let wanted = if config.tare == Tare::Auto { MIN_TARE_FRAMES } else { 1 };
            if *frames < wanted {
                if config.tare == Tare::Auto && config.gravity == Gravity::Removed {
                    let none = DVector::zeros(untared.len());
                    self.state = State::Known(none);
                    return Ok(Some(untared.clone()));
                }
                return Err(TrackerError::NoContactFreeStart { found: *frames, wanted });
            }
            self.state = State::Known(&*sum / f64::from(*frames));
        }
        Ok(self.known().map(|tare| untared - tare))
    }

    /// Checks, at the end of a touch, that it had as many frames as were requested for the tare.
    ///
    /// # Errors
    ///
    /// If a number of tare frames was requested and the touch is shorter.
    pub(crate) fn end(&self, tare: Tare) -> Result<(), TrackerError> {
        match (tare, &self.state) {
            (Tare::Frames(wanted), &State::Open { frames: found, .. }) if found < wanted => {
                Err(TrackerError::TareTooLong { found, wanted })
            }
            _ => Ok(()),
        }
    }
}
