//! Computes contacts and external torques from logged samples, one by one.
//!
//! A [`Tracker`] follows one touch after another: it moves the arm through the lattice ([`crate::motion`]), converts
//! the sign of the torque and subtracts gravity ([`crate::external_torque`]) and then the tare ([`crate::tare`]). It
//! does not use stiffness: learning ([`crate::mapper`]) and predicting ([`crate::field`]) use the same tracker, so they
//! have the same contacts and torques.

use std::sync::Arc;

use nalgebra::DVector;

use crate::arm::Arm;
use crate::contact::{ContactConfig, ContactState, Contacts};
use crate::downsampling::Downsampling;
use crate::external_torque::{ExternalTorqueConfig, MAX_TORQUE};
use crate::lattice::Lattice;
use crate::motion::{MotionError, MotionSimulator, Substeps};
use crate::robot::{Poses, RobotError};
use crate::setting::SettingError;
use crate::tare::TouchTare;

/// Joint positions and torques of the robot at one moment.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Sample {
    /// Time, s, if the log has it.
    pub time_s: Option<f64>,
    /// Joint positions, n_joints, rad or m.
    pub q: Vec<f64>,
    /// Joint torques as logged, n_joints, N·m or N.
    pub tau: Vec<f64>,
    /// Standard deviation of the torques, n_joints, N·m, if known for this sample (identified arms only). Its square is
    /// added to that of the estimator's `torque_std`.
    pub tau_std: Option<Vec<f64>>,
}

impl Sample {
    /// A sample: time, s, if known; positions, rad or m, and torques, N·m or N, one of each for every joint.
    pub fn new(time_s: Option<f64>, q: Vec<f64>, tau: Vec<f64>) -> Self {
        Self { time_s, q, tau, tau_std: None }
    }
}

/// What can be wrong with a sample or a touch.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum TrackerError {
    /// The wrong number of joint torques.
    #[error("got {got} joint torques, the robot has {expected} moving joints")]
    TorqueCount { expected: usize, got: usize },
    /// The wrong number of standard deviations, or one that is negative, NaN or too large.
    #[error(
        "the standard deviations of the torques are {found:?}; wanted {expected} from 0 to {MAX_TORQUE} N·m"
    )]
    TorqueStd { expected: usize, found: Vec<f64> },
    /// A torque model that is invalid or of another arm.
    #[error("the torque model of the arm cannot be used: {0}")]
    TorqueModel(String),
    /// A torque that is NaN or too large.
    #[error("the torque of joint `{joint}` is {found}; wanted a number of N·m below {MAX_TORQUE}")]
    Torque { joint: String, found: f64 },
    /// A motion that is too long for two consecutive samples.
    #[error(
        "joint `{joint}` jumps from {from} to {to}; a motion this long cannot be followed: are \
         samples missing, or are the positions in another unit?"
    )]
    Jump { joint: String, from: f64, to: f64 },
    /// Invalid joint positions.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// Too few contact-free frames for a tare.
    #[error(
        "the touch has no contact-free start: after {found} frames the arm has moved and touches the \
         lattice, and the tare needs at least {wanted} frames before that; start the log earlier, give the number of \
         frames yourself (`tare_frames`), or set `no_tare` if the torques are external already"
    )]
    NoContactFreeStart { found: u32, wanted: u32 },
    /// Fewer frames than were requested for the tare.
    #[error(
        "the touch ends after {found} frames; the tare was set to use {wanted} (`tare_frames`)"
    )]
    TareTooLong { found: u32, wanted: u32 },
    /// A sample before any touch was begun, or after the touch had failed.
    #[error("a sample came before a touch was begun, or after its touch had failed")]
    NotBegun,
}

impl From<MotionError> for TrackerError {
    fn from(error: MotionError) -> Self {
        match error {
            MotionError::Robot(error) => Self::Robot(error),
            MotionError::Jump { joint, from, to } => Self::Jump { joint, from, to },
        }
    }
}

/// A sample with its geometry and its external torque.
#[derive(Debug, Clone)]
pub struct TrackedSample {
    /// Poses of the links.
    pub poses: Poses,
    /// The contacts.
    pub contacts: Contacts,
    /// Measured torque with the sign of τ_ext, minus gravity but not minus the tare, n_joints, N·m.
    pub untared: DVector<f64>,
    /// τ_ext, n_joints, N·m; `None` while the tare is being computed.
    pub external: Option<DVector<f64>>,
    /// Standard deviation of τ_ext, n_joints, N·m, if the sample has one.
    pub tau_std: Option<Vec<f64>>,
    /// Whether to learn from this sample ([`Downsampling`]).
    pub is_learnt: bool,
}

/// Weights for [`crate::unstable::Observation::weighted`], for torques with standard deviations `tau_std`, n_joints,
/// N·m: an estimator with noise `torque_std` (one for all joints, or one for each) then uses the noise
/// `√(torque_std² + tau_std²)`.
pub fn torque_weights(tau_std: &[f64], torque_std: &[f64]) -> Vec<f64> {
    let own = |joint: usize| torque_std[joint.min(torque_std.len() - 1)];
    let joints = tau_std.iter().enumerate();
    joints.map(|(joint, std)| own(joint) / own(joint).hypot(*std)).collect()
}

/// Computes contacts and external torques of one touch after another.
#[derive(Debug, Clone)]
pub struct Tracker {
    motion: MotionSimulator,
    config: ExternalTorqueConfig,
    /// Whether a touch is under way.
    begun: bool,
    /// The tare of the touch under way, from its first sample on.
    tare: Option<TouchTare>,
    /// Selects the samples to learn from.
    downsampling: Downsampling,
}

impl Tracker {
    /// A tracker of an arm in a lattice.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range.
    pub fn new(
        arm: Arc<Arm>,
        lattice: Lattice,
        contact: &ContactConfig,
        config: ExternalTorqueConfig,
    ) -> Result<Self, SettingError> {
        config.check()?;
        let motion = MotionSimulator::new(arm, lattice, contact)?;
        Ok(Self { motion, config, begun: false, tare: None, downsampling: Downsampling::default() })
    }

    /// The arm.
    pub fn arm(&self) -> &Arc<Arm> {
        self.motion.arm()
    }

    /// How the arm's motions are cut into sub-steps.
    pub(crate) fn substeps(&self) -> &Substeps {
        self.motion.substeps()
    }

    /// Whether a touch is under way: begun, not ended, and not failed for lack of a tare.
    pub(crate) fn is_in_touch(&self) -> bool {
        self.begun
    }

    /// Time of the last learnt sample of the touch, s.
    pub(crate) fn learnt_s(&self) -> Option<f64> {
        self.downsampling.last_s
    }

    /// Sets the time of the last learnt sample, s.
    pub(crate) fn set_learnt_s(&mut self, learnt_s: Option<f64>) {
        self.downsampling.last_s = learnt_s;
    }

    /// Present joint positions, n_joints, and contacts; `None` outside a touch, or before its first position.
    pub(crate) fn current_state(&self) -> Option<(Vec<f64>, ContactState)> {
        self.begun.then(|| self.motion.current_state())?
    }

    /// Starts a touch: contacts and tare of the last one are forgotten.
    pub fn begin_touch(&mut self) {
        self.begun = true;
        self.tare = None;
        self.downsampling = Downsampling::default();
        self.motion.begin_touch();
    }

    /// Takes the next sample of the touch.
    ///
    /// # Errors
    ///
    /// If the sample does not fit the robot, or has an invalid value: the tracker is then unchanged, and the next
    /// sample can follow. If the touch turns out to have no contact-free start: the touch is then over, and a new one
    /// must be begun.
    pub fn feed(&mut self, sample: &Sample) -> Result<TrackedSample, TrackerError> {
        if !self.begun {
            return Err(TrackerError::NotBegun);
        }
        let (poses, untared) = self.check(sample)?;
        let contacts = self.motion.go(&sample.q, &poses)?;
        let tare = self.tare.get_or_insert_with(|| TouchTare::begin(&sample.q, self.config.tare));
        let settings = (&self.motion.arm().robot, &self.config);
        let tau_std = sample.tau_std.clone();
        let now = (&sample.q[..], !contacts.is_empty(), tau_std.as_deref());
        let external = tare.subtract(settings, now, &untared);
        self.begun = external.is_ok();
        let external = external?;
        let is_learnt = self.downsampling.takes(sample);
        Ok(TrackedSample { poses, contacts, untared, external, tau_std, is_learnt })
    }

    /// Passes over the next sample of the touch, if it is not to be learnt and the tare is known: the sample is checked,
    /// and the arm moves straight from the sample before to the one after. Returns whether it was passed over; otherwise
    /// the sample must be fed.
    ///
    /// # Errors
    ///
    /// As [`Tracker::check`]; the tracker is then unchanged.
    pub fn pass_over(&mut self, sample: &Sample) -> Result<bool, TrackerError> {
        if !self.begun || self.tare().is_none() {
            return Ok(false);
        }
        self.check(sample)?;
        let mut downsampling = self.downsampling.clone();
        let is_passed = !downsampling.takes(sample);
        if is_passed {
            self.downsampling = downsampling;
        }
        Ok(is_passed)
    }

    /// The poses of the links in a sample, and its torque with the sign of τ_ext, minus gravity, n_joints, N·m; does
    /// not change the tracker.
    ///
    /// # Errors
    ///
    /// If the sample does not fit the robot, or has an invalid value.
    pub fn check(&self, sample: &Sample) -> Result<(Poses, DVector<f64>), TrackerError> {
        let poses = self.arm().robot.forward(&sample.q)?;
        let untared = self.config.untared(&self.arm().robot, &poses, &sample.tau)?;
        if let Some(std) = &sample.tau_std
            && (std.len() != sample.q.len()
                || !std.iter().all(|std| (0.0..=MAX_TORQUE).contains(std)))
        {
            let (expected, found) = (sample.q.len(), std.clone());
            return Err(TrackerError::TorqueStd { expected, found });
        }
        Ok((poses, untared))
    }

    /// The tare of the touch, n_joints, N·m, once it is known.
    pub fn tare(&self) -> Option<&DVector<f64>> {
        self.tare.as_ref()?.known()
    }

    /// The contacts of the last [`TrackedSample`]; none before the first.
    pub fn contacts(&self) -> Contacts {
        self.motion.contacts()
    }

    /// Checks, at the end of a touch, that it was long enough for its tare.
    ///
    /// # Errors
    ///
    /// If a number of tare frames was requested and the touch is shorter.
    pub fn end_touch(&mut self) -> Result<(), TrackerError> {
        self.begun = false;
        self.tare.as_ref().map_or(Ok(()), |tare| tare.end(self.config.tare))
    }
}
