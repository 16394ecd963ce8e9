//! The tare: the mean torque of a touch while nothing is touched.
//!
//! Sensors drift between touches, so every touch has a tare of its own: the mean of what the sign and
//! gravity leave of the logged torque over the contact-free frames at its start. A frame counts as
//! contact-free while the arm stands still, or while the simulator finds it touching no point of the
//! lattice; the start ends at the first frame that is neither. Without such a start, torques out of which the
//! robot has taken gravity are external ones as they are; others need one. Of an identified arm, whose torques have a
//! standard deviation, the start ends as well where they are more than that explains.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::external_torque::{ExternalTorqueConfig, Gravity};
use crate::robot::Robot;
use crate::tracker::TrackerError;

/// Which frames of a touch give its tare.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tare {
    /// The contact-free start, found by itself.
    #[default]
    Auto,
    /// The first frames, so many.
    Frames(u32),
    /// None: the torques are external ones already.
    None,
}

/// The fewest contact-free frames that give a tare.
pub const MIN_TARE_FRAMES: u32 = 5;

/// Standard deviations that the torques of an identified arm may be away from zero while nothing is touched.
const MOST_STDS: f64 = 4.0;

/// Whether a frame belongs to the contact-free start of a touch, if all before it do: the arm
/// stands where the touch began, or touches no point of the lattice.
///
/// Joint positions where the touch began and now are n_joints each, rad or m, as is `still_rad`.
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
    untared.iter().zip(std).all(|(torque, std)| torque.abs() <= MOST_STDS * std)
}

/// The tare of one touch, as far as it has come.
#[derive(Debug, Clone)]
pub(crate) struct TouchTare {
    /// Joint positions where the touch began, n_joints.
    q_start: Vec<f64>,
    state: State,
}

#[derive(Debug, Clone)]
enum State {
    /// Being taken: the sum over the frames so far.
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

    /// Adds a frame to the tare, or subtracts the tare from it: τ_ext, n_joints, N·m, or `None` while
    /// the tare is being taken.
    ///
    /// `in_contact` says whether the arm touches any point of the lattice.
    ///
    /// # Errors
    ///
    /// If the contact-free start is over before there were frames enough, and the torques hold gravity.
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

    /// Checks, at the end of a touch, that it had as many frames as were asked for.
    ///
    /// # Errors
    ///
    /// If a number of tare frames was asked for and the touch is shorter.
    pub(crate) fn end(&self, tare: Tare) -> Result<(), TrackerError> {
        match (tare, &self.state) {
            (Tare::Frames(wanted), &State::Open { frames: found, .. }) if found < wanted => {
                Err(TrackerError::TareTooLong { found, wanted })
            }
            _ => Ok(()),
        }
    }
}
