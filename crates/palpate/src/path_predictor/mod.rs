//! What torque a motion would meet that has not been made yet.
//!
//! [`crate::mapper::Mapper::path_predictor`] hands out an [`PathPredictor`]: the field as it is at that moment,
//! and the arm with what it touches. It belongs to whoever asked, so that another thread can put
//! paths to it while the mapper goes on; asking changes nothing of the mapper, and what the mapper
//! learns meanwhile changes nothing of the answer.
//!
//! | here                      | value                                    | shape    | unit |
//! |---------------------------|------------------------------------------|----------|------|
//! | [`PathPoint::torque`]     | `τ̂ = Σ wᵢ Kᵢ` (Eq. 5)                    | n_joints | N·m  |
//! | [`PathPoint::torque_std`] | `√ diag(H P Hᵀ)`, P the cells' variances | n_joints | N·m  |
//!
//! # Where a path starts
//!
//! Contacts have a history: what a link has pushed aside, it still holds. A path that starts where
//! the arm is in a touch under way ([`PathConfig::start_cells`]) goes on from the contacts there. Any
//! other starts free of contact, as a touch does: what the links cover at its first point is taken
//! for empty space ([`crate::ContactConfig::known_empty`]), so let it begin outside the object.
//!
//! # Where it is looked at closely
//!
//! Every motion costs a look at all that is touched, so points are not asked about one by one. The
//! arm is taken from one *stop* to the next, as far as [`PathConfig::resolution_cells`]
//! allows; between stops, torques go along the way in proportion. The first and the last point are
//! stops, and so is every one where the arm turns round: there friction changes its direction.
//! At a resolution of 0 all points are stops, and the answer is that of
//! [`crate::field::Predictor`] but for rounding.
//!
//! # Where an answer must come fast
//!
//! A path is known beforehand, and no point's way along it depends on another's: so points are
//! followed alone, in pieces for as many threads as have time, and cost little until a link is near
//! ([`crate::contact`]). One can stand for others: [`Mapper::coarse_path_predictor`] has one for a block of
//! neighbours, with the stiffness of all, in blocks as small as the stiff and the hardly known ones
//! need. With one in [`CLUSTER_WEIGHT`] and a stop every cell (the default), that moved torques of touches
//! of three simulated plants by 1 to 6 % from path to path, and their standard deviations by 5 to
//! 18 %, where the field had not learnt those; where it had, by 1 to 8 %, once by 15 %, and by 3 to
//! 23 %. What the field itself gets wrong is 33 %.
//!
//! # What the standard deviation means
//!
//! It is what the uncertainty of the springs alone ([`crate::map`] says what that is) makes of the
//! torque, spring by spring: cells never touched have the prior's, so it is large where the field
//! knows nothing and small where much was learnt. Neither the noise of the sensors nor what the
//! contact model gets wrong is in it, and the springs count as independent, though those that are
//! always pressed together are known by their sum only. Take it as a ranking of paths by how well
//! their resistance is known, not as a bound on the error.
//!
//! [`Mapper::coarse_path_predictor`]: crate::mapper::Mapper::coarse_path_predictor

mod clusters;
mod link_wrenches;
mod parallel;
mod path;
mod springs;

use std::sync::Arc;

use nalgebra::{DVector, Isometry3};
use serde::{Deserialize, Serialize};

use self::link_wrenches::LinkWrenches;
use self::parallel::in_pieces;
pub use self::path::{CheckedPath, PathChecker};
pub(crate) use self::springs::Springs;
use crate::arm::Arm;
use crate::contact::{ContactConfig, ContactState, PathContactSimulator, PosedTrajectory};
use crate::lattice::Lattice;
use crate::motion::MotionError;
use crate::robot::RobotError;
use crate::setting::SettingError;
use crate::tracker::Tracker;

/// How closely a path is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PathConfig {
    /// The farthest that a point of the arm goes from one stop to the next, in cells; 0 stops at
    /// every point.
    pub resolution_cells: f64,
    /// The farthest that a point of the arm may be from where it was in the last sample of a touch
    /// for the path to go on from there, in cells.
    pub start_cells: f64,
}

impl Default for PathConfig {
    fn default() -> Self {
        Self { resolution_cells: 1.0, start_cells: 1.0 }
    }
}

/// Points of a path at most.
pub const MAX_POINTS: usize = 100_000;

/// Stops and sub-steps of a path at most, each: a few seconds.
pub const MAX_MOTIONS: usize = 10_000;

/// Springs of the mean for which one stands at most where an answer must come fast; see
/// [`Mapper::coarse_path_predictor`](crate::mapper::Mapper::coarse_path_predictor).
pub const CLUSTER_WEIGHT: f64 = 24.0;

/// Why a path cannot be looked at. Points are counted from 0.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum PathError {
    /// A setting outside its range.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// Nothing to answer.
    #[error("the path has no points; give at least one, of a position for each joint")]
    Empty,
    /// More points than one question may have.
    #[error("the path has {found} points, more than {MAX_POINTS}; ask about it in pieces")]
    TooManyPoints { found: usize },
    /// Joint positions that the robot cannot take.
    #[error("point {point} of the path: {reason}")]
    Point { point: usize, reason: RobotError },
    /// A motion too long to be one.
    #[error(
        "joint `{joint}` jumps from {from} to {to} on the way to point {point} of the path; so \
         long a motion cannot be followed: are there points missing, or is it in another unit?"
    )]
    Jump { point: usize, joint: String, from: f64, to: f64 },
    /// More motion than one question may have.
    #[error(
        "up to point {point} the path takes more than {MAX_MOTIONS} motions to follow; ask about \
         it in pieces, or at a coarser resolution"
    )]
    TooLong { point: usize },
}

impl PathError {
    fn at(point: usize, lost: MotionError) -> Self {
        match lost {
            MotionError::Robot(reason) => Self::Point { point, reason },
            MotionError::Jump { joint, from, to } => Self::Jump { point, joint, from, to },
        }
    }
}

/// What the field says of one point of a path.
#[derive(Debug, Clone, PartialEq)]
pub struct PathPoint {
    /// τ̂: external torque, n_joints, N·m.
    pub torque: DVector<f64>,
    /// Standard deviation of that, n_joints, N·m; see [the module](self) for what it means.
    pub torque_std: DVector<f64>,
    /// Points of the lattice touched.
    pub contacts: usize,
    /// Those of them that were touched when the field was learnt.
    pub known: usize,
}

/// What the field says of a path.
#[derive(Debug, Clone, PartialEq)]
pub struct PathPrediction {
    /// One for each point of the path.
    pub points: Vec<PathPoint>,
    /// Whether the path went on from what the arm touched, rather than free of contact.
    pub goes_on: bool,
    /// Points of the path where the arm stopped; torques of the others lie between theirs.
    pub stops: usize,
}

/// A field at one moment, and the arm where it was.
#[derive(Debug, Clone)]
pub struct PathPredictor {
    arm: Arc<Arm>,
    checker: PathChecker,
    lattice: Lattice,
    contact: ContactConfig,
    /// Joint positions where the arm is in a touch, n_joints, and what it holds there.
    current_state: Option<(Vec<f64>, Arc<ContactState>)>,
    springs: Arc<Springs>,
}

/// Pieces that a short path is answered in; always as many, so that sums have the same order.
const PIECES: usize = 16;

/// Pieces of a long one at least.
const FEW_PIECES: usize = 4;

/// Stops above which there are fewer pieces, since each keeps sums for every stop.
const FEW_STOPS: usize = 256;

impl PathPredictor {
    /// A path predictor of the arm that is tracked.
    pub(crate) fn new(tracker: &Tracker, contact: ContactConfig, springs: Springs) -> Self {
        let lattice = springs.lattice().clone();
        Self {
            arm: Arc::clone(tracker.arm()),
            checker: PathChecker::new(tracker.substeps().clone(), lattice.spacing_m()),
            lattice,
            contact,
            current_state: tracker
                .current_state()
                .map(|(q, contact_state)| (q, Arc::new(contact_state))),
            springs: Arc::new(springs),
        }
    }

    /// What torque a path would meet, from where the arm is; the next question starts there too.
    ///
    /// `path` has a row of n_joints positions (rad, m where prismatic) a point. Joints go straight
    /// from one to the next, angles the shorter way round. As many threads take part as rayon has
    /// and as have time; sums have the same order however many that are.
    ///
    /// # Errors
    ///
    /// If the path is empty, too long, or has a point that does not fit the robot.
    pub fn ask<Q: AsRef<[f64]>>(
        &self,
        path: &[Q],
        config: &PathConfig,
    ) -> Result<PathPrediction, PathError> {
        self.answer(&self.checker.check(path, config)?)
    }

    /// [`PathPredictor::ask`] about a path that was checked beforehand, by the checker of the same mapper.
    ///
    /// # Errors
    ///
    /// If a motion between two stops, or from where the arm is to the first, is too long.
    ///
    /// # Panics
    ///
    /// If the path was checked for another robot, which is a bug in the caller.
    pub fn answer(&self, path: &CheckedPath<'_>) -> Result<PathPrediction, PathError> {
        let from = self.current_state.as_ref().filter(|from| self.starts_at(from, path));
        let way = self.way(path, from)?;
        let felt = self.felt(&way, from.map(|(_, contact_state)| Arc::clone(contact_state)));
        let mut points: Vec<PathPoint> = Vec::new();
        for (number, &stop) in path.stops.iter().enumerate() {
            let first = way.at.partition_point(|at| *at < way.at[number]);
            let reached = felt.point(first, &self.arm.robot, path.poses(stop));
            if let Some(left) = points.last().cloned() {
                let from = points.len() - 1;
                points.extend((from + 1..stop).map(|point| {
                    let part = path.part(point, [from, stop]);
                    PathPoint::between(&left, &reached, part)
                }));
            }
            points.push(reached);
        }
        Ok(PathPrediction { points, goes_on: from.is_some(), stops: path.stops.len() })
    }

    /// Whether a path starts where the arm is.
    fn starts_at(
        &self,
        (q, contact_state): &(Vec<f64>, Arc<ContactState>),
        path: &CheckedPath<'_>,
    ) -> bool {
        let path_length_m =
            self.checker.substeps().path_length_m((q, &contact_state.poses), path.at(0));
        path_length_m.is_ok_and(|path_length_m| path_length_m <= path.start_m)
    }

    /// The waypoints of a path, from where the arm is or from the first stop.
    fn way(
        &self,
        path: &CheckedPath<'_>,
        from: Option<&(Vec<f64>, Arc<ContactState>)>,
    ) -> Result<Way, PathError> {
        let mut before = match from {
            Some((q, contact_state)) => (&q[..], &contact_state.poses[..]),
            None => path.at(path.stops[0]),
        };
        let mut way =
            Way { waypoints: vec![before.1.to_vec()], at: Vec::with_capacity(path.stops.len()) };
        for &stop in &path.stops {
            let here = path.at(stop);
            let between = self.checker.substeps().between(before, here);
            for poses in between.map_err(|lost| PathError::at(stop, lost))? {
                way.go(&poses);
            }
            way.go(here.1);
            way.at.push(way.waypoints.len() - 1);
            if way.at.last() > Some(&(2 * MAX_MOTIONS)) {
                return Err(PathError::TooLong { point: stop });
            }
            before = here;
        }
        Ok(way)
    }

    /// What the arm feels at the stops of a way; at the first, where several are at the same
    /// waypoint.
    fn felt(&self, way: &Way, contact_state: Option<Arc<ContactState>>) -> LinkWrenches {
        let surfaces = Arc::clone(&self.arm.surfaces);
        let (links, stops) = (surfaces.len(), way.at.len());
        let (lattice, contact) = (self.lattice.clone(), self.contact.clone());
        let roughly = self.springs.are_few();
        let trajectory = PosedTrajectory::new(
            lattice,
            surfaces,
            &contact,
            roughly,
            contact_state,
            &way.waypoints,
        );
        let mut stop_at = vec![None; way.waypoints.len()];
        way.at.iter().enumerate().rev().for_each(|(stop, &at)| stop_at[at] = Some(stop));
        let (bricks, springs) = (trajectory.bricks(), Arc::clone(&self.springs));
        let pieces = (PIECES * FEW_STOPS / stops).clamp(FEW_PIECES, PIECES);
        let of_piece = move |piece: usize| {
            let (mut path_simulator, mut of_crowd) =
                (PathContactSimulator::new(&trajectory), Vec::new());
            let [first, end] = [piece, piece + 1].map(|piece| piece * bricks.len() / pieces);
            for near in &bricks[first..end] {
                for (place, spring) in springs.of_brick(near.low) {
                    let aside_m = spring.aside * springs.lattice().spacing_m();
                    path_simulator.add(near, place, &aside_m);
                    of_crowd.push(spring);
                }
            }
            let mut felt = LinkWrenches::nothing(stops, links);
            path_simulator.follow(&stop_at, |stop, path_simulator, displaced| {
                let number = displaced.index;
                felt.add(stop, &of_crowd[number], path_simulator.rest(number), &displaced);
            });
            felt
        };
        let felt = in_pieces(pieces, of_piece).into_iter().reduce(|mut sum, piece| {
            sum.merge(piece);
            sum
        });
        felt.unwrap_or_default()
    }
}

impl PathConfig {
    /// Checks every setting.
    fn check(&self) -> Result<(), PathError> {
        let settings =
            [("resolution_cells", self.resolution_cells), ("start_cells", self.start_cells)];
        match settings.into_iter().find(|(_, found)| !(0.0..=1e3).contains(found)) {
            Some((setting, found)) => {
                Err(SettingError::new(setting, found, "from 0 to 1000 cells").into())
            }
            None => Ok(()),
        }
    }
}

/// The waypoints that the arm goes through.
struct Way {
    /// The links' poses, by link.
    waypoints: Vec<Vec<Isometry3<f64>>>,
    /// The numbers of the waypoints where it stops, by stop.
    at: Vec<usize>,
}

impl Way {
    /// Goes to a waypoint, unless the arm is there.
    fn go(&mut self, poses: &[Isometry3<f64>]) {
        if self.waypoints.last().is_none_or(|last| last != poses) {
            self.waypoints.push(poses.to_vec());
        }
    }
}
