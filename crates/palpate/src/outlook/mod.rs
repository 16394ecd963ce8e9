//! What torque a motion would meet that has not been made yet.
//!
//! [`crate::mapper::Mapper::outlook`] hands out an [`Outlook`]: the field as it is at that moment,
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
//! the arm is in a touch under way ([`Config::start_cells`]) goes on from the contacts there. Any
//! other starts free of contact, as a touch does: what the links cover at its first point is taken
//! for empty space ([`crate::contact::Config::known_empty`]), so let it begin outside the object.
//!
//! # Where it is looked at closely
//!
//! A motion of the simulator costs a quarter of a millisecond, so points are not asked about one
//! by one. The arm is taken from one *stop* to the next, as far as [`Config::resolution_cells`]
//! allows; between stops, torques go along the way in proportion. The first and the last point are
//! stops, and so is every one where the arm turns round: there friction changes its direction.
//! At a resolution of 0 all points are stops, and the answer is that of
//! [`crate::field::Predictor`] to the bit.
//!
//! # Where an answer must come fast
//!
//! What a stop costs follows the points touched. No point's way depends on another's, so some of
//! them can stand for the rest: [`Mapper::thinned_outlook`] keeps one of a block of neighbours, with
//! the stiffness of all, in blocks as small as the stiff and the hardly known ones need. With one in
//! [`ONE_IN`], on touches of three simulated plants that the field had not learnt, and with a stop
//! every cell (the default), that moved torques by 1 to 9 % from path to path, and their standard
//! deviations by 2 to 22 %; what the field itself gets wrong is 33 %. For the same reason several
//! threads can share an answer: [`Outlook::ask_in_parts`].
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
//! [`Mapper::thinned_outlook`]: crate::mapper::Mapper::thinned_outlook

mod felt;
mod groups;
mod route;

use std::sync::Arc;

use nalgebra::DVector;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use self::felt::Felt;
use self::groups::{Leaders, Spring};
use self::route::Route;
use crate::contact::{Chosen, Contacts, Share};
use crate::field::{CellEstimate, Springs};
use crate::follow::{Follower, Lost};
use crate::lattice::CellRows;
use crate::robot::{Poses, RobotError};

/// How closely a path is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The farthest that a point of the arm goes from one stop to the next, in cells; 0 stops at
    /// every point.
    pub resolution_cells: f64,
    /// The farthest that a point of the arm may be from where it was in the last sample of a touch
    /// for the path to go on from there, in cells.
    pub start_cells: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self { resolution_cells: 1.0, start_cells: 1.0 }
    }
}

/// Points of a path at most.
pub const MAX_POINTS: usize = 100_000;

/// Stops and sub-steps of a path at most, each: a few seconds.
pub const MAX_MOTIONS: usize = 10_000;

/// Springs of the mean for which one stands at most where an answer must come fast; see
/// [`Mapper::thinned_outlook`](crate::mapper::Mapper::thinned_outlook).
pub const ONE_IN: f64 = 16.0;

/// Why a path cannot be looked at. Points are counted from 0.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum PathError {
    /// A setting out of its range.
    #[error("{setting} is {found}; it must be {wanted}")]
    Setting { setting: &'static str, found: f64, wanted: &'static str },
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
    fn at(point: usize, lost: Lost) -> Self {
        match lost {
            Lost::Robot(reason) => Self::Point { point, reason },
            Lost::Jump { joint, from, to } => Self::Jump { point, joint, from, to },
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
pub struct Answer {
    /// One for each point of the path.
    pub points: Vec<PathPoint>,
    /// Whether the path went on from what the arm touched, rather than free of contact.
    pub goes_on: bool,
    /// Points of the path where the arm stopped; torques of the others lie between theirs.
    pub stops: usize,
}

/// A field at one moment, and the arm where it was.
#[derive(Debug, Clone)]
pub struct Outlook {
    arm: Follower,
    springs: Springs,
    /// The diagonal of P, (N/m)², by row of the springs; then that of all other cells.
    variance: Vec<f64>,
    untouched_variance: f64,
    /// For how many each cell stands, by row, if not for itself alone; then all other cells.
    stands_for: Vec<f64>,
    others_stand_for: f64,
}

impl Outlook {
    /// An outlook of an arm that is in a touch, or before its first position; `estimate` knows the
    /// cells by row, and of any other number what is said of cells without one.
    pub(crate) fn new(
        arm: Follower,
        rows: &CellRows,
        estimate: impl Fn(usize) -> CellEstimate,
    ) -> Self {
        let known: Vec<CellEstimate> = (0..rows.len()).map(&estimate).collect();
        let stiffness: Vec<f64> = known.iter().map(|cell| cell.stiffness_n_per_m).collect();
        let counts = known.iter().map(|cell| cell.count).collect();
        let untouched = estimate(usize::MAX);
        Self {
            arm,
            springs: Springs::new(rows.clone(), &stiffness, counts, untouched.stiffness_n_per_m),
            variance: known.iter().map(|cell| cell.std_n_per_m.powi(2)).collect(),
            untouched_variance: untouched.std_n_per_m.powi(2),
            stands_for: Vec::new(),
            others_stand_for: 1.0,
        }
    }

    /// [`Outlook::new`] with springs that each stand for neighbours, of which none weighs more than
    /// `one_in` of the mean; `arm` is one that follows these only.
    pub(crate) fn thinned(
        arm: impl FnOnce(Arc<Chosen>) -> Follower,
        rows: &CellRows,
        estimate: impl Fn(usize) -> CellEstimate,
        one_in: f64,
    ) -> Self {
        let spring = |row| {
            let CellEstimate { stiffness_n_per_m, std_n_per_m, .. } = estimate(row);
            Spring { stiffness_n_per_m, variance: std_n_per_m.powi(2) }
        };
        let known: Vec<Spring> = (0..rows.len()).map(spring).collect();
        let Leaders { leaders, chosen } = Leaders::new(rows, &known, one_in);
        let mut led = CellRows::new(rows.lattice().clone());
        for leader in &leaders {
            led.row_of(rows.cells()[leader.row]);
        }
        let stiffness: Vec<f64> = leaders.iter().map(|leader| leader.stiffness_n_per_m).collect();
        let counts = leaders.iter().map(|leader| estimate(leader.row).count).collect();
        let (untouched, others_stand_for) = (spring(usize::MAX), Chosen::ONE_IN);
        let untouched_n_per_m = untouched.stiffness_n_per_m * others_stand_for;
        Self {
            arm: arm(Arc::new(chosen)),
            springs: Springs::new(led, &stiffness, counts, untouched_n_per_m),
            variance: leaders.iter().map(|leader| leader.variance).collect(),
            untouched_variance: untouched.variance * others_stand_for,
            stands_for: leaders.iter().map(|leader| leader.stands_for).collect(),
            others_stand_for,
        }
    }

    /// What torque a path would meet, from where the arm is; the next question starts there too.
    ///
    /// `path` has a row of n_joints positions (rad, m where prismatic) a point. Joints go straight
    /// from one to the next, angles the shorter way round. Cost: some 0.3 ms a stop for an arm
    /// that touches two thousand points.
    ///
    /// # Errors
    ///
    /// If the path is empty, too long, or has a point that does not fit the robot.
    pub fn ask<Q: AsRef<[f64]>>(
        &mut self,
        path: &[Q],
        config: &Config,
    ) -> Result<Answer, PathError> {
        let arm = self.arm.clone();
        let answer = self.follow(path, config);
        self.arm = arm;
        answer
    }

    /// [`Outlook::ask`], after which the arm is at the path's end with what it touches there, for
    /// paths that go on from this one.
    ///
    /// # Errors
    ///
    /// As [`Outlook::ask`]; where the arm is then is not said.
    pub fn follow<Q: AsRef<[f64]>>(
        &mut self,
        path: &[Q],
        config: &Config,
    ) -> Result<Answer, PathError> {
        let way = self.way(path, config)?;
        let felt = self.walk(&way)?;
        Ok(way.answer(&felt))
    }

    /// [`Outlook::ask`] by so many threads, each of which follows its share of the points.
    ///
    /// Sums of torques come in another order than in [`Outlook::ask`], the same for the same number
    /// of parts.
    ///
    /// # Errors
    ///
    /// As [`Outlook::ask`].
    pub fn ask_in_parts<Q: AsRef<[f64]> + Sync>(
        &self,
        path: &[Q],
        config: &Config,
        parts: u32,
    ) -> Result<Answer, PathError> {
        let way = self.way(path, config)?;
        let of = parts.max(1);
        let walk = |part| {
            let arm = self.arm.following(None, Share { part, of });
            let (springs, variance) = (self.springs.clone(), self.variance.clone());
            let stands_for = self.stands_for.clone();
            Self { arm, springs, variance, stands_for, ..*self }.walk(&way)
        };
        let felt: Vec<Vec<Felt>> =
            (0..of).into_par_iter().map(walk).collect::<Result<_, PathError>>()?;
        let felt = felt.into_iter().reduce(|mut sum, part| {
            sum.iter_mut().zip(&part).for_each(|(sum, part)| *sum += part);
            sum
        });
        Ok(way.answer(&felt.unwrap_or_default()))
    }

    /// A path that was found fit to be followed from where the arm is, with its stops.
    fn way<'a, Q: AsRef<[f64]>>(
        &self,
        path: &'a [Q],
        config: &Config,
    ) -> Result<Way<'a>, PathError> {
        config.check()?;
        let route = Route::new(&self.arm, path)?;
        let goes_on = self.starts_here(&route, config);
        let resolution_m = config.resolution_cells * self.arm.simulator().lattice().spacing_m();
        let stops = route.stops(&self.arm, resolution_m);
        if stops.len() > MAX_MOTIONS {
            return Err(PathError::TooLong { point: stops[MAX_MOTIONS] });
        }
        Ok(Way { route, goes_on, stops })
    }

    /// Takes the arm along a way; what it feels at each stop.
    fn walk(&mut self, way: &Way<'_>) -> Result<Vec<Felt>, PathError> {
        if !way.goes_on {
            self.arm.begin_touch();
        }
        let reach = |&stop: &usize| {
            let (q, poses) = way.route.at(stop);
            let contacts = self.arm.go(q, poses).map_err(|lost| PathError::at(stop, lost))?;
            Ok(self.feel(poses, &contacts))
        };
        way.stops.iter().map(reach).collect()
    }

    /// Whether a route starts where the arm is in a touch under way.
    fn starts_here(&self, route: &Route<'_>, config: &Config) -> bool {
        let limit_m = config.start_cells * self.arm.simulator().lattice().spacing_m();
        let Some(here) = self.arm.q() else { return false };
        let poses = self.arm.arm().robot.forward(here);
        let way_m = poses.ok().and_then(|poses| self.arm.way_m((here, &poses), route.at(0)).ok());
        way_m.is_some_and(|way_m| way_m <= limit_m)
    }

    /// What the arm feels at these poses, with these contacts.
    fn feel(&mut self, poses: &Poses, contacts: &Contacts) -> Felt {
        let robot = &self.arm.arm().robot;
        let nothing = DVector::zeros(robot.n_joints());
        if contacts.is_empty() {
            let (torque, torque_variance) = (nothing.clone(), nothing);
            return Felt { torque, torque_variance, contacts: 0.0, known: 0.0 };
        }
        let observation = self.springs.fold(robot, poses, contacts, &nothing);
        let of = |values: &[f64], row: usize, other| values.get(row).copied().unwrap_or(other);
        let variance = |row| of(&self.variance, row, self.untouched_variance);
        let stands_for = |row| of(&self.stands_for, row, self.others_stand_for);
        let known = observation.rows().filter(|&row| self.springs.is_known(row));
        Felt {
            torque: self.springs.predict(&observation),
            torque_variance: observation.gram(self.springs.cells(), variance).diagonal(),
            contacts: observation.rows().map(stands_for).sum(),
            known: known.map(stands_for).sum(),
        }
    }
}

impl Config {
    /// Checks every setting.
    fn check(&self) -> Result<(), PathError> {
        let settings =
            [("resolution_cells", self.resolution_cells), ("start_cells", self.start_cells)];
        match settings.into_iter().find(|(_, found)| !(0.0..=1e3).contains(found)) {
            Some((setting, found)) => {
                Err(PathError::Setting { setting, found, wanted: "from 0 to 1000 cells" })
            }
            None => Ok(()),
        }
    }
}

/// A path with the points of it where the arm stops.
struct Way<'a> {
    route: Route<'a>,
    goes_on: bool,
    stops: Vec<usize>,
}

impl Way<'_> {
    /// The answer, from what is felt at each stop.
    fn answer(&self, felt: &[Felt]) -> Answer {
        let mut points: Vec<PathPoint> = Vec::new();
        for (&stop, felt) in self.stops.iter().zip(felt) {
            let reached = felt.point();
            if let Some(left) = points.last().cloned() {
                let from = points.len() - 1;
                points.extend((from + 1..stop).map(|point| {
                    let part = self.route.part(point, [from, stop]);
                    PathPoint::between(&left, &reached, part)
                }));
            }
            points.push(reached);
        }
        Answer { points, goes_on: self.goes_on, stops: self.stops.len() }
    }
}
