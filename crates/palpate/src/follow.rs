//! The arm on its way from one joint position to the next, and what it touches there.
//!
//! Whoever asks for the contacts of a motion asks here, whether it is learnt from, predicted, or
//! only thought of: so the same motion always has the same contacts. Long motions are cut into
//! sub-steps, short enough that nothing tunnels. The module knows no torque.

use std::sync::Arc;

use nalgebra::Isometry3;

use crate::arm::Arm;
use crate::contact::{self, Chosen, Contacts, Share, Simulator};
use crate::lattice::Lattice;
use crate::robot::{Poses, RobotError};

/// The farthest that a joint turns (rad) or slides (m) in a piece of a motion whose ends are
/// compared to count its sub-steps: short enough for chord and arc to differ by a millimetre.
const PIECE: f64 = 0.1;

/// Motions longer than this many pieces, or pieces of more sub-steps, are refused.
const MAX_PARTS: f64 = 1000.0;

/// Why the arm cannot be followed.
#[derive(Debug)]
pub(crate) enum Lost {
    /// Joint positions that the robot cannot take.
    Robot(RobotError),
    /// A motion too long to be one.
    Jump { joint: String, from: f64, to: f64 },
}

impl From<RobotError> for Lost {
    fn from(error: RobotError) -> Self {
        Self::Robot(error)
    }
}

/// Takes the arm along its way.
#[derive(Debug, Clone)]
pub(crate) struct Follower {
    arm: Arc<Arm>,
    simulator: Simulator,
    /// Where the arm is; `None` before the first position of a touch.
    q: Option<Vec<f64>>,
}

impl Follower {
    pub(crate) fn new(
        arm: Arc<Arm>,
        lattice: Lattice,
        contact: contact::Config,
    ) -> Result<Self, contact::ConfigError> {
        let simulator = Simulator::new(lattice, Arc::clone(&arm.surfaces), contact)?;
        Ok(Self { arm, simulator, q: None })
    }

    pub(crate) fn arm(&self) -> &Arc<Arm> {
        &self.arm
    }

    pub(crate) fn simulator(&self) -> &Simulator {
        &self.simulator
    }

    /// One that is where this one is, and from there on follows a share of the points only, or of
    /// those chosen if any are.
    pub(crate) fn following(&self, chosen: Option<Arc<Chosen>>, share: Share) -> Self {
        let simulator = self.simulator.following(chosen, share);
        Self { arm: Arc::clone(&self.arm), simulator, q: self.q.clone() }
    }

    /// What the arm displaces where it is.
    pub(crate) fn contacts(&self) -> Contacts {
        self.simulator.contacts()
    }

    /// Joint positions where the arm is, n_joints; `None` before the first of a touch.
    pub(crate) fn q(&self) -> Option<&[f64]> {
        self.q.as_deref()
    }

    /// Forgets where the arm is and what it touches: the next position starts a touch.
    pub(crate) fn begin_touch(&mut self) {
        self.q = None;
    }

    /// Takes the arm to joint positions `q`, where its links have these poses, and returns what it
    /// displaces there. After an error the arm is where it was.
    pub(crate) fn go(&mut self, q: &[f64], poses: &Poses) -> Result<Contacts, Lost> {
        if let Some(from) = &self.q {
            for between in self.stops(from, q, poses)? {
                self.simulator.advance(&between);
            }
        } else {
            self.simulator.begin_touch(&poses.world_from_link);
        }
        self.q = Some(q.to_vec());
        Ok(self.simulator.advance(&poses.world_from_link))
    }

    /// How far the fastest point of the arm goes from one joint position to another, where the
    /// links have these poses, m.
    pub(crate) fn way_m(
        &self,
        (from, start): (&[f64], &Poses),
        (to, end): (&[f64], &Poses),
    ) -> Result<f64, Lost> {
        let (mut way_m, mut start) = (0.0, start.world_from_link.clone());
        self.pieces(from, to, end, |_, piece_end| {
            way_m += self.simulator.travel_m(&start, &piece_end);
            start = piece_end;
            Ok(())
        })?;
        Ok(way_m)
    }

    /// The poses between the arm's joint positions and the next, without the ends, close enough
    /// that nothing tunnels. `end` are those of the next.
    fn stops(
        &self,
        from: &[f64],
        to: &[f64],
        end: &Poses,
    ) -> Result<Vec<Vec<Isometry3<f64>>>, Lost> {
        let (mut between, mut start) = (Vec::new(), self.simulator.poses().to_vec());
        self.pieces(from, to, end, |[piece, pieces], piece_end| {
            let parts = f64::from(self.simulator.substeps(&start, &piece_end));
            if parts > MAX_PARTS {
                return Err(self.jump(from, to));
            }
            for part in 1..parts as u32 {
                let part = (piece + f64::from(part) / parts) / pieces;
                between.push(self.poses_at(from, to, part)?);
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
        to: &[f64],
        end: &Poses,
        mut take: impl FnMut([f64; 2], Vec<Isometry3<f64>>) -> Result<(), Lost>,
    ) -> Result<(), Lost> {
        let way = self.arm.robot.difference(from, to);
        let longest = way.iter().fold(0.0, |most: f64, way| most.max(way.abs()));
        let pieces = (longest / PIECE).ceil().max(1.0);
        if pieces > MAX_PARTS {
            return Err(self.jump(from, to));
        }
        for piece in 0..pieces as u32 {
            let piece_end = match f64::from(piece + 1) / pieces {
                part if part < 1.0 => self.poses_at(from, to, part)?,
                _ => end.world_from_link.clone(),
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
    fn jump(&self, from: &[f64], to: &[f64]) -> Lost {
        let robot = &self.arm.robot;
        let way = robot.difference(from, to);
        let joint = (0..way.len()).max_by(|&a, &b| way[a].abs().total_cmp(&way[b].abs()));
        let joint = joint.unwrap_or_default();
        let name = robot.joint_names().nth(joint).unwrap_or_default().to_owned();
        Lost::Jump { joint: name, from: from[joint], to: to[joint] }
    }
}
