//! The arm on its way from one joint position to the next, and what it touches there.
//!
//! Whoever needs the contacts of a motion comes here, and whoever only thinks of one cuts it into
//! sub-steps as this does: so the same motion always has the same contacts. Long motions are cut
//! into sub-steps, short enough that nothing tunnels. The module knows no torque.

use std::sync::Arc;

use nalgebra::Isometry3;

use crate::arm::Arm;
use crate::contact::{self, ContactConfig, ContactSimulator, ContactState, Contacts};
use crate::lattice::Lattice;
use crate::robot::{Poses, Robot, RobotError};
use crate::setting::SettingError;

/// The farthest that a joint turns (rad) or slides (m) in a piece of a motion whose ends are
/// compared to count its sub-steps: short enough for chord and arc to differ by a millimetre.
const PIECE: f64 = 0.1;

/// Motions of more pieces than this are refused: no arm goes two turns, or twelve metres, from one
/// sample to the next.
const MAX_PIECES: f64 = 126.0;

/// Pieces of more sub-steps than this are refused.
const MAX_SUBSTEPS: f64 = 1000.0;

/// Why the arm cannot be followed.
#[derive(Debug)]
pub(crate) enum MotionError {
    /// Joint positions that the robot cannot take.
    Robot(RobotError),
    /// A motion too long to be one.
    Jump { joint: String, from: f64, to: f64 },
}

impl From<RobotError> for MotionError {
    fn from(error: RobotError) -> Self {
        Self::Robot(error)
    }
}

/// Where the arm is, as joint positions and the links' poses there.
pub(crate) type Waypoint<'a> = (&'a [f64], &'a [Isometry3<f64>]);

/// Cuts the arm's motions into sub-steps.
#[derive(Debug, Clone)]
pub(crate) struct Substeps {
    arm: Arc<Arm>,
    /// The farthest that a point of the arm goes in one, m.
    substep_m: f64,
}

/// Takes the arm along its way.
#[derive(Debug, Clone)]
pub(crate) struct MotionSimulator {
    substeps: Substeps,
    simulator: ContactSimulator,
    /// Where the arm is; `None` before the first position of a touch.
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

    /// What the arm displaces where it is.
    pub(crate) fn contacts(&self) -> Contacts {
        self.simulator.contacts()
    }

    /// Joint positions where the arm is, n_joints, and what it holds there; `None` before the first
    /// position of a touch.
    pub(crate) fn current_state(&self) -> Option<(Vec<f64>, ContactState)> {
        Some((self.q.clone()?, self.simulator.state().clone()))
    }

    /// Forgets where the arm is and what it touches: the next position starts a touch.
    pub(crate) fn begin_touch(&mut self) {
        self.q = None;
    }

    /// Takes the arm to joint positions `q`, where its links have these poses, and returns what it
    /// displaces there. After an error the arm is where it was.
    pub(crate) fn go(&mut self, q: &[f64], poses: &Poses) -> Result<Contacts, MotionError> {
        if let Some(from) = &self.q {
            let (from, to) = ((&from[..], self.simulator.poses()), (q, &poses.world_from_link[..]));
            for between in self.substeps.between(from, to)? {
                self.simulator.advance(&between);
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

    /// The farthest that a point of the arm goes in a sub-step, m.
    pub(crate) fn substep_m(&self) -> f64 {
        self.substep_m
    }

    /// How far a point of the arm goes from one waypoint to another as the crow flies, m.
    pub(crate) fn chord_length_m(&self, from: &[Isometry3<f64>], to: &[Isometry3<f64>]) -> f64 {
        contact::travel_m(&self.arm.surfaces, from, to)
    }

    /// How far the fastest point of the arm goes from one waypoint to another, m.
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

    /// The poses between one waypoint and another, without the ends, close enough that nothing
    /// tunnels.
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
        between.pop(); // the end of the last piece is where the motion ends
        Ok(between)
    }

    /// Cuts a motion into pieces short enough to compare their ends: `take` gets the number of a
    /// piece and how many there are, and the poses at its end.
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

    /// The links' poses a part (0 to 1) of the way.
    fn poses_at(
        &self,
        from: &[f64],
        to: &[f64],
        part: f64,
    ) -> Result<Vec<Isometry3<f64>>, RobotError> {
        let robot = &self.arm.robot;
        Ok(robot.forward(&robot.interpolate(from, to, part))?.world_from_link)
    }

    /// The joint that goes farthest, and from where to where.
    fn jump(&self, from: &[f64], to: &[f64]) -> MotionError {
        let robot = &self.arm.robot;
        let way = robot.difference(from, to);
        let joint = (0..way.len()).max_by(|&a, &b| way[a].abs().total_cmp(&way[b].abs()));
        let joint = joint.unwrap_or_default();
        let name = robot.joint_names().nth(joint).unwrap_or_default().to_owned();
        MotionError::Jump { joint: name, from: from[joint], to: to[joint] }
    }
}
