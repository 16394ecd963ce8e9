//! One touch: from what the robot logs to contacts and external torques.
//!
//! τ_ext = ± τ_measured − τ_gravity(q) − tare. The tare is the mean of what is left over while
//! nothing is touched, afresh for every touch, since sensors drift between touches. Frames are
//! contact-free from the start of a touch for as long as the arm stands still, or the simulator
//! finds it touching no point of the lattice. What the two agree to call the start ends at the
//! first frame that is neither.
//!
//! The module knows no stiffness: learning ([`crate::mapper`]) and predicting
//! ([`crate::field`]) see the same frames.

use std::sync::Arc;

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

use crate::arm::Arm;
use crate::contact::{ContactConfig, ContactState, Contacts};
use crate::lattice::Lattice;
use crate::motion::{MotionError, MotionSimulator, Substeps};
use crate::robot::{Poses, Robot, RobotError};
use crate::setting::SettingError;

/// What the robot reports at one moment.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// Time, s, if the log has it.
    pub time_s: Option<f64>,
    /// Joint positions, n_joints, rad or m.
    pub q: Vec<f64>,
    /// Joint torques as logged, n_joints, N·m or N.
    pub tau: Vec<f64>,
}

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

/// How raw torques become external ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExternalTorqueConfig {
    /// Sign of the logged torques.
    pub torque_sign: TorqueSign,
    /// Whether they hold gravity.
    pub gravity: Gravity,
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

/// The fewest contact-free frames that give a tare.
pub const MIN_TARE_FRAMES: u32 = 5;

/// What can be wrong with a sample or a touch.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum TrackerError {
    /// The wrong number of joint torques.
    #[error("got {got} joint torques, the robot has {expected} moving joints")]
    TorqueCount { expected: usize, got: usize },
    /// A torque that is no number, or none of this world.
    #[error("the torque of joint `{joint}` is {found}; wanted a number of N·m below {MAX_TORQUE}")]
    Torque { joint: String, found: f64 },
    /// A motion that no arm makes between two samples.
    #[error(
        "joint `{joint}` jumps from {from} to {to}; so long a motion cannot be followed: are there \
         samples missing, or is it in another unit?"
    )]
    Jump { joint: String, from: f64, to: f64 },
    /// Joint positions that the robot cannot take.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// Nothing to tare on.
    #[error(
        "the touch has no contact-free start: the arm moves after {found} frames, and at least \
         {wanted} still ones are needed for the tare; start the log earlier, give the number of \
         frames yourself (--tare-frames N), or use --no-tare if the torques are external already"
    )]
    NoContactFreeStart { found: u32, wanted: u32 },
    /// Fewer frames than were to be averaged.
    #[error("the touch ends after {found} frames, before the {wanted} that were asked for as tare")]
    TareTooLong { found: u32, wanted: u32 },
    /// A sample before any touch began, or after one that could not be used.
    #[error("a sample came without a touch that was begun and is still good")]
    NotBegun,
}

impl From<MotionError> for TrackerError {
    fn from(lost: MotionError) -> Self {
        match lost {
            MotionError::Robot(error) => Self::Robot(error),
            MotionError::Jump { joint, from, to } => Self::Jump { joint, from, to },
        }
    }
}

/// A frame with everything geometry can say of it.
#[derive(Debug, Clone)]
pub struct TrackedSample {
    /// Links' poses.
    pub poses: Poses,
    /// What the arm displaces.
    pub contacts: Contacts,
    /// Measured torque with the sign of τ_ext, less gravity and with its bias, n_joints, N·m.
    pub untared: DVector<f64>,
    /// τ_ext, n_joints, N·m; `None` while the tare is being taken.
    pub external: Option<DVector<f64>>,
}

/// How far the tare of a touch has come.
#[derive(Debug, Clone)]
enum TareState {
    Open { sum: DVector<f64>, frames: u32 },
    Closed(DVector<f64>),
}

/// Where a touch stands.
#[derive(Debug, Clone)]
struct Progress {
    q_start: Vec<f64>,
    tare: TareState,
}

/// Follows one touch after another.
#[derive(Debug, Clone)]
pub struct Tracker {
    motion: MotionSimulator,
    config: ExternalTorqueConfig,
    begun: bool,
    progress: Option<Progress>,
}

impl Tracker {
    /// A tracker of an arm in a lattice.
    ///
    /// # Errors
    ///
    /// If a setting of the contact model is out of its range.
    pub fn new(
        arm: Arc<Arm>,
        lattice: Lattice,
        contact: ContactConfig,
        config: ExternalTorqueConfig,
    ) -> Result<Self, SettingError> {
        if !(config.still_rad >= 0.0 && config.still_rad.is_finite()) {
            let (found, wanted) = (config.still_rad, "zero or more, and finite");
            return Err(SettingError::new("still_rad", found, wanted));
        }
        let motion = MotionSimulator::new(arm, lattice, contact)?;
        Ok(Self { motion, config, begun: false, progress: None })
    }

    /// The arm that is followed.
    pub fn arm(&self) -> &Arc<Arm> {
        self.motion.arm()
    }

    /// How the arm's motions are cut into sub-steps.
    pub(crate) fn substeps(&self) -> &Substeps {
        self.motion.substeps()
    }

    /// Joint positions where the arm is, n_joints, and what it holds there; `None` outside a touch,
    /// or before its first position.
    pub(crate) fn current_state(&self) -> Option<(Vec<f64>, ContactState)> {
        self.begun.then(|| self.motion.current_state())?
    }

    /// Starts a touch: contacts and tare of the last one are forgotten.
    pub fn begin_touch(&mut self) {
        self.begun = true;
        self.progress = None;
        self.motion.begin_touch();
    }

    /// Takes the next sample of the touch.
    ///
    /// # Errors
    ///
    /// If the sample does not fit the robot, or holds a value that is no number: the tracker is
    /// then as before it, and may go on with the next. If it shows that the touch has no
    /// contact-free start: that touch is over, and the next call must begin another.
    pub fn feed(&mut self, sample: &Sample) -> Result<TrackedSample, TrackerError> {
        if !self.begun {
            return Err(TrackerError::NotBegun);
        }
        let poses = self.arm().robot.forward(&sample.q)?;
        let untared = self.config.untared(&self.arm().robot, &poses, &sample.tau)?;
        let contacts = self.move_arm(&sample.q, &poses)?;
        let external = self.subtract_tare(&sample.q, untared.clone(), &contacts)?;
        Ok(TrackedSample { poses, contacts, untared, external })
    }

    /// The tare of the touch, n_joints, N·m, once it is known.
    pub fn tare(&self) -> Option<&DVector<f64>> {
        match &self.progress.as_ref()?.tare {
            TareState::Closed(tare) => Some(tare),
            TareState::Open { .. } => None,
        }
    }

    /// What the arm displaced in the last sample: the contacts of its [`TrackedSample`]; none before the
    /// first.
    pub fn contacts(&self) -> Contacts {
        self.motion.contacts()
    }

    /// Checks, at the end of a touch, that it was long enough for its tare.
    ///
    /// # Errors
    ///
    /// If a number of tare frames was asked for and the touch is shorter.
    pub fn end_touch(&mut self) -> Result<(), TrackerError> {
        self.begun = false;
        match (self.config.tare, self.progress.as_ref().map(|progress| &progress.tare)) {
            (Tare::Frames(wanted), Some(&TareState::Open { frames: found, .. }))
                if found < wanted =>
            {
                Err(TrackerError::TareTooLong { found, wanted })
            }
            _ => Ok(()),
        }
    }

    /// Takes the arm to a sample's poses; the first sample of a touch opens its tare.
    fn move_arm(&mut self, q: &[f64], poses: &Poses) -> Result<Contacts, TrackerError> {
        let contacts = self.motion.go(q, poses)?;
        if self.progress.is_none() {
            let (sum, frames) = (DVector::zeros(q.len()), 0);
            let tare = match self.config.tare {
                Tare::None => TareState::Closed(sum),
                Tare::Auto | Tare::Frames(_) => TareState::Open { sum, frames },
            };
            self.progress = Some(Progress { q_start: q.to_vec(), tare });
        }
        Ok(contacts)
    }

    /// Adds a contact-free frame to the tare, or takes the tare off.
    fn subtract_tare(
        &mut self,
        q: &[f64],
        raw: DVector<f64>,
        contacts: &Contacts,
    ) -> Result<Option<DVector<f64>>, TrackerError> {
        let robot = &self.motion.arm().robot;
        let progress = self.progress.as_mut().expect("move_arm made it");
        if let TareState::Open { sum, frames } = &mut progress.tare {
            let moved = robot.difference(&progress.q_start, q);
            let still = moved.iter().all(|way| way.abs() <= self.config.still_rad);
            let goes_on = match self.config.tare {
                Tare::Frames(wanted) => *frames < wanted,
                _ => still || contacts.is_empty(),
            };
            if goes_on {
                *sum += raw;
                *frames += 1;
                return Ok(None);
            }
            let wanted = if self.config.tare == Tare::Auto { MIN_TARE_FRAMES } else { 1 };
            if *frames < wanted {
                self.begun = false;
                return Err(TrackerError::NoContactFreeStart { found: *frames, wanted });
            }
            progress.tare = TareState::Closed(&*sum / f64::from(*frames));
        }
        match &progress.tare {
            TareState::Closed(tare) => Ok(Some(raw - tare)),
            TareState::Open { .. } => Ok(None),
        }
    }
}
