//! Motion of the arm from one joint position to the next, and its contacts on the way.
//!
//! Long motions are cut into sub-steps, short enough that no cell is passed over. Logged and
//! planned motions are cut in the same way, so the same motion always has the same contacts. The
//! module does not use torques.

use std::sync::Arc;

use nalgebra::Isometry3;

use crate::arm::Arm;
use crate::contact::{self, ContactConfig, ContactSimulator, ContactState, Contacts};
use crate::lattice::Lattice;
use crate::robot::{Poses, Robot, RobotError};
use crate::setting::SettingError;

/// Largest joint motion, rad or m, in one *piece* of a motion. The sub-steps of a piece are counted
/// from the distance between its two ends: the piece is so short that chord and arc differ by about
/// a millimetre.
const PIECE: f64 = 0.1;

/// Motions of more pieces than this are refused: no arm moves by two turns, or twelve metres, from
/// one sample to the next.
const MAX_PIECES: f64 = 126.0;

/// Motions with more sub-steps than this in one piece are refused.
const MAX_SUBSTEPS: f64 = 1000.0;

/// Why a motion cannot be simulated.
#[derive(Debug)]
pub(crate) enum MotionError {
    /// Invalid joint positions.
    Robot(RobotError),
    /// A motion that is too long for two consecutive samples.
    Jump { joint: String, from: f64, to: f64 },
}

impl From<RobotError> for MotionError {
    fn from(error: RobotError) -> Self {
        Self::Robot(error)
    }
}

/// Joint positions (n_joints) and the poses of the links there.
pub(crate) type Waypoint<'a> = (&'a [f64], &'a [Isometry3<f64>]);

/// Cuts the arm's motions into sub-steps.
#[derive(Debug, Clone)]
pub(crate) struct Substeps {
    arm: Arc<Arm>,
    /// Largest motion of a point of the arm in one sub-step, m.
    substep_m: f64,
}

/// Moves the arm and keeps its contacts.
#[derive(Debug, Clone)]
pub(crate) struct MotionSimulator {
    substeps: Substeps,
    simulator: ContactSimulator,
    /// Present joint positions; `None` before the first position of a touch.
    q: Option<Vec<f64>>,
}

impl MotionSimulator {
    pub(crate) fn new(
        arm: Arc<Arm>,
        lattice: Lattice,
        contact: &ContactConfig,
    ) -> Result<Self, SettingError> {
        let simulator = ContactSimulator::new(lattice, Arc::clone(&arm.surfaces), contact)?;
        let substeps = Substeps { arm, substep_m: simulator.substep_m() };
        Ok(Self { substeps, simulator, q: None })
    }

    pub(crate) fn arm(&self) -> &Arc<Arm> {
        &self.substeps.arm
    }

    pub(crate) fn substeps(&self) -> &Substeps {
        &self.substeps
    }

    /// The contacts at the present position.
    pub(crate) fn contacts(&self) -> Contacts {
        self.simulator.contacts()
    }

    /// Present joint positions, n_joints, and contacts; `None` before the first position of a
    /// touch.
    pub(crate) fn current_state(&self) -> Option<(Vec<f64>, ContactState)> {
        Some((self.q.clone()?, self.simulator.state().clone()))
    }

    /// Forgets the position of the arm and its contacts: the next position starts a touch.
    pub(crate) fn begin_touch(&mut self) {
        self.q = None;
    }

    /// Moves the arm to joint positions `q`, where its links have these poses, and returns the
    /// contacts there. After an error the state is unchanged.
    pub(crate) fn go(&mut self, q: &[f64], poses: &Poses) -> Result<Contacts, MotionError> {
        if let Some(from) = &self.q {
            let (from, to) = ((&from[..], self.simulator.poses()), (q, &poses.world_from_link[..]));
            for between in self.substeps.between(from, to)? {
                self.simulator.move_to(&between);
            }
        } else {
            self.simulator.begin_touch(&poses.world_from_link);
        }
        self.q = Some(q.to_vec());
        Ok(self.simulator.advance(&poses.world_from_link))
    }
}

impl Substeps {
    pub(crate) fn robot(&self) -> &Robot {
        &self.arm.robot
    }

    /// Largest motion of a point of the arm in a sub-step, m.
    pub(crate) fn substep_m(&self) -> f64 {
        self.substep_m
    }

    /// Largest straight-line distance that a point of the arm moves between two waypoints, m.
    pub(crate) fn chord_length_m(&self, from: &[Isometry3<f64>], to: &[Isometry3<f64>]) -> f64 {
        contact::travel_m(&self.arm.surfaces, from, to)
    }

    /// Path length of the fastest point of the arm between two waypoints, m.
    pub(crate) fn path_length_m(
        &self,
        from: Waypoint<'_>,
        to: Waypoint<'_>,
    ) -> Result<f64, MotionError> {
        let (mut path_length_m, mut start) = (0.0, from.1.to_vec());
        self.pieces(from.0, to, |_, piece_end| {
            path_length_m += self.chord_length_m(&start, &piece_end);
            start = piece_end;
            Ok(())
        })?;
        Ok(path_length_m)
    }

    /// Poses between two waypoints, without the ends, so close that no cell is passed over.
    pub(crate) fn between(
        &self,
        from: Waypoint<'_>,
        to: Waypoint<'_>,
    ) -> Result<Vec<Vec<Isometry3<f64>>>, MotionError> {
        let (mut between, mut start) = (Vec::new(), from.1.to_vec());
        self.pieces(from.0, to, |[piece, pieces], piece_end| {
            let travel_m = self.chord_length_m(&start, &piece_end);
            let parts = f64::from(contact::substeps(travel_m, self.substep_m));
            if parts > MAX_SUBSTEPS {
                return Err(self.jump(from.0, to.0));
            }
            for part in 1..parts as u32 {
                let part = (piece + f64::from(part) / parts) / pieces;
                between.push(self.poses_at(from.0, to.0, part)?);
            }
            start.clone_from(&piece_end);
            between.push(piece_end);
            Ok(())
        })?;
        between.pop(); // the last pose is the end of the motion
        Ok(between)
    }

    /// Cuts a motion into pieces of at most [`PIECE`]: `take` gets the number of a piece and the
    /// number of all pieces, and the poses at its end.
    fn pieces(
        &self,
        from: &[f64],
        (to, end): Waypoint<'_>,
        mut take: impl FnMut([f64; 2], Vec<Isometry3<f64>>) -> Result<(), MotionError>,
    ) -> Result<(), MotionError> {
        let way = self.arm.robot.difference(from, to);
        let longest = way.iter().fold(0.0, |most: f64, way| most.max(way.abs()));
        let pieces = (longest / PIECE).ceil().max(1.0);
        if pieces > MAX_PIECES {
            return Err(self.jump(from, to));
        }
        for piece in 0..pieces as u32 {
            let piece_end = match f64::from(piece + 1) / pieces {
                part if part < 1.0 => self.poses_at(from, to, part)?,
                _ => end.to_vec(),
            };
            take([f64::from(piece), pieces], piece_end)?;
        }
        Ok(())
    }

    /// Poses of the links at a fraction (0 to 1) of the motion.
    fn poses_at(
        &self,
        from: &[f64],
        to: &[f64],
        part: f64,
    ) -> Result<Vec<Isometry3<f64>>, RobotError> {
        let robot = &self.arm.robot;
        Ok(robot.forward(&robot.interpolate(from, to, part))?.world_from_link)
    }

    /// The error for a motion that is too long, with the joint that moves farthest.
    fn jump(&self, from: &[f64], to: &[f64]) -> MotionError {
        let robot = &self.arm.robot;
        let way = robot.difference(from, to);
        let joint = (0..way.len()).max_by(|&a, &b| way[a].abs().total_cmp(&way[b].abs()));
        let joint = joint.unwrap_or_default();
        let name = robot.joint_names().nth(joint).unwrap_or_default().to_owned();
        MotionError::Jump { joint: name, from: from[joint], to: to[joint] }
    }
}
