//! Predicts the torque along a planned motion.
//!
//! [`crate::Mapper::path_predictor`] copies the present field, and the arm with its contacts, into a [`PathPredictor`].
//! The copy can be used on another thread while the mapper goes on: predictions do not change the mapper, and what the
//! mapper learns later does not change the predictions.
//!
//! | here                      | value                                    | shape    | unit |
//! |---------------------------|------------------------------------------|----------|------|
//! | [`PathPoint::torque`]     | `τ̂ = Σ wᵢ Kᵢ` (Eq. 5)                    | n_joints | N·m  |
//! | [`PathPoint::torque_std`] | `√ diag(H P Hᵀ)`, P the cells' variances | n_joints | N·m  |
//! | [`PathPoint::torque_rss`] | `√ diag(H diag(K²) Hᵀ)`                  | n_joints | N·m  |
//!
//! # Where a path starts
//!
//! Contacts depend on the motion before. A path that starts at the present position of the arm in a touch under way
//! ([`PathConfig::start_cells`]) continues from the contacts there. Any other path starts free of contact, as a touch
//! does: points that the links cover at its first point count as empty space ([`ContactConfig::known_empty`]), so it
//! should begin outside the object. To predict a posture, or a part of a path, inside the object, set
//! [`PathConfig::inside`]: how the arm got there is unknown, and the points that it covers count as pushed out to the
//! nearest surface.
//!
//! # Stops
//!
//! The contacts are evaluated at *stops*, at most [`PathConfig::resolution_cells`] apart; between two stops torques are
//! interpolated by the path length. The first and the last point are stops, and so is every point where the arm
//! reverses, because friction changes its direction there. With a resolution of 0 all points are stops, and the
//! prediction is that of [`crate::Predictor`] up to rounding.
//!
//! # Coarse predictors
//!
//! The trajectory is known, and the contact of a point does not depend on other points. So points are followed
//! independently, in chunks for all free threads, and take little computation until a link is near
//! ([`crate::contact`]). One point can also represent others: [`crate::Mapper::coarse_path_predictor`] has one spring
//! for a cluster of neighbours, with the sum of their stiffness; clusters are smallest where cells are stiff or
//! uncertain. Compared with all springs, [`CLUSTER_WEIGHT`] and a stop every cell (the default) changed the torques of
//! touches of three simulated plants by 1 to 6 % from path to path, and their standard deviations by 5 to 18 %, for
//! fields that had not learnt those touches. For fields that had, the changes were 1 to 8 % (once 15 %), and 3 to 23 %.
//! The error of the field itself is 33 %.
//!
//! # Elastic bodies
//!
//! With [`PathPredictor::with_body`] a path also bends an [`ElasticModel`], waypoint by waypoint, from its present
//! shape if the path continues from the present contacts. A path has no times: creep of contacts is computed for the
//! speed of the touches. The springs beside the body then have the stiffness [`ElasticModel::spring_n_per_m`]; standard
//! deviations stay those of the field.
//!
//! # What the standard deviation means
//!
//! It is the standard deviation of the torque that follows from those of the springs, taken as independent
//! ([`crate::map`] explains what these mean). Untouched cells have that of the prior, so it is large where nothing was
//! learnt and small where much was learnt. It does not include noise of the sensors and errors of the contact model. Of
//! springs that are always pressed together only the sum is known, so they are not really independent. Use it to rank
//! paths by how well their torque is known, not as a bound on the error.

mod clusters;
mod config;
mod error;
mod link_wrenches;
mod parallel;
mod path;
mod prediction;
mod springs;

use std::sync::Arc;

use nalgebra::{DVector, Isometry3};
use rayon::prelude::*;

pub use self::clusters::CLUSTER_WEIGHT;
use self::config::{MAX_BODY_STOPS, MAX_STOPS};
pub use self::config::{MAX_POINTS, PathConfig};
pub use self::error::PathError;
use self::link_wrenches::LinkWrenches;
use self::parallel::in_chunks;
pub use self::path::{CheckedPath, PathChecker};
pub use self::prediction::{PathPoint, PathPrediction};
pub(crate) use self::springs::Springs;
use crate::arm::Arm;
use crate::calibration::Calibration;
use crate::contact::{ContactConfig, ContactState, PathContactSimulator, PosedTrajectory};
use crate::elastic::{ElasticModel, ElasticTorque};
use crate::external_torque::ExternalTorqueConfig;
use crate::field::Field;
use crate::lattice::CellRows;
use crate::setting::SettingError;
use crate::tracker::Tracker;

/// A copy of a field, and of the arm with its contacts, to predict the torque of motions.
#[derive(Debug, Clone)]
pub struct PathPredictor {
    arm: Arc<Arm>,
    checker: PathChecker,
    contact: ContactConfig,
    /// In a touch: present joint positions of the arm, n_joints, and contacts.
    current_state: Option<(Vec<f64>, Arc<ContactState>)>,
    springs: Arc<Springs>,
    /// The object as an elastic body, bent as at the present position of the arm.
    body: Option<ElasticTorque>,
    /// Calibration of bands.
    calibration: Option<Arc<Calibration>>,
}

/// Number of chunks of points for a short path; it is fixed, so that sums have a fixed order.
const CHUNKS: usize = 16;

/// Least number of chunks, for a long path.
const FEW_CHUNKS: usize = 4;

/// Number of stops above which there are fewer chunks, since each chunk keeps sums for every stop.
const FEW_STOPS: usize = 256;

impl PathPredictor {
    /// A predictor for the arm of a tracker, at its present position.
    pub(crate) fn new(tracker: &Tracker, contact: ContactConfig, springs: Springs) -> Self {
        let spacing_m = springs.lattice().spacing_m();
        Self {
            arm: Arc::clone(tracker.arm()),
            checker: PathChecker::new(tracker.substeps().clone(), spacing_m),
            contact,
            current_state: tracker
                .current_state()
                .map(|(q, contact_state)| (q, Arc::new(contact_state))),
            springs: Arc::new(springs),
            body: None,
            calibration: None,
        }
    }

    /// A predictor from a field alone, for an arm that may be another than the one it was learnt with. All paths start
    /// free of contact. For an arm with another number of joints there are no bands.
    ///
    /// `untouched_std_n_per_m` is the standard deviation of cells that are not in the field, N/m; with a
    /// `cluster_weight` above 1 springs represent clusters, as in [`crate::Mapper::coarse_path_predictor`].
    ///
    /// # Errors
    ///
    /// If a setting of the field's contact model is out of its range.
    pub fn of_field(
        arm: &Arc<Arm>,
        field: &Field,
        untouched_std_n_per_m: f64,
        cluster_weight: f64,
    ) -> Result<Self, SettingError> {
        let (lattice, touch) = (field.lattice.clone(), ExternalTorqueConfig::default());
        let tracker = Tracker::new(Arc::clone(arm), lattice, &field.contact, touch)?;
        let rows = CellRows::of(field.lattice.clone(), &field.cells);
        let estimate = |row| field.estimate(row, untouched_std_n_per_m);
        let known = (0..rows.len() as u32).map(|row| estimate(Some(row))).collect();
        let springs = Springs::of(&rows, known, estimate(None), cluster_weight);
        let predictor = Self::new(&tracker, field.contact.clone(), springs);
        Ok(match field.elastic.as_deref() {
            Some(model) => predictor.with_body(model, ElasticTorque::new(arm, model)),
            None => predictor.calibrated(field.calibration.clone()),
        })
    }

    /// Sets the calibration of bands, if it is for this number of joints.
    #[must_use]
    pub(crate) fn calibrated(mut self, calibration: Option<Calibration>) -> Self {
        let fits = |own: &Calibration| own.check(self.n_joints()).is_ok();
        self.calibration = calibration.filter(fits).map(Arc::new);
        self
    }

    /// Adds an elastic body, bent as at the present position of the arm, and takes its bands.
    #[must_use]
    pub fn with_body(mut self, model: &ElasticModel, body: ElasticTorque) -> Self {
        Arc::make_mut(&mut self.springs).set_beside_body(model);
        self.body = Some(body);
        self.calibrated(model.calibration.clone())
    }

    /// Number of joint positions of each point of a path.
    pub fn n_joints(&self) -> usize {
        self.checker.n_joints()
    }

    /// Predicts the torque along a path, without changing the predictor.
    ///
    /// `path` has n_joints positions (rad, m where prismatic) for each point. Joints move linearly from one point to
    /// the next, angles the shorter way round. Free threads of rayon take part; sums have the same order for any number
    /// of threads.
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

    /// [`PathPredictor::ask`] for many paths, on all of rayon's threads; the results are equal to the bit.
    ///
    /// `stopped` is called before every path; if it returns true, the computation ends and the result is `None`.
    ///
    /// # Errors
    ///
    /// As [`PathPredictor::ask`], with the number of the first path that cannot be followed, from 0.
    pub fn ask_all<P: AsRef<[Q]> + Sync, Q: AsRef<[f64]>>(
        &self,
        paths: &[P],
        config: &PathConfig,
        stopped: impl Fn() -> bool + Sync,
    ) -> Result<Option<Vec<PathPrediction>>, (usize, PathError)> {
        let answers = paths.par_iter().map(|path| {
            let goes_on = !stopped();
            goes_on.then(|| self.ask(path.as_ref(), config)).transpose()
        });
        let answers: Vec<_> = answers.collect();
        let numbered = answers.into_iter().enumerate();
        numbered.map(|(number, answer)| answer.map_err(|error| (number, error))).collect()
    }

    /// [`PathPredictor::ask`] for a path that was checked by a [`PathChecker`] of the same mapper.
    ///
    /// # Errors
    ///
    /// If a motion between two stops, or from the present position to the first stop, is too long.
    ///
    /// # Panics
    ///
    /// If the path was checked for another robot, which is a bug in the caller.
    pub fn answer(&self, path: &CheckedPath<'_>) -> Result<PathPrediction, PathError> {
        let from = self.current_state.as_ref().filter(|from| self.starts_at(from, path));
        let waypoints = self.waypoints(path, from)?;
        if let Some(number) = waypoints.stops.iter().position(|at| *at > MAX_BODY_STOPS)
            && self.body.is_some()
        {
            return Err(PathError::TooLong { point: path.stops[number], most: MAX_BODY_STOPS });
        }
        let state = from.map(|(_, state)| Arc::clone(state));
        let wrenches = self.wrenches(&waypoints, state, path.inside);
        let of_body = self.torques_of_body(path, &waypoints, from.is_some());
        let mut points: Vec<PathPoint> = Vec::new();
        for (number, &stop) in path.stops.iter().enumerate() {
            let first = waypoints.stops.partition_point(|at| *at < waypoints.stops[number]);
            let mut reached = wrenches.point(first, &self.arm.robot, path.poses(stop));
            if let Some(torque) = of_body.get(number) {
                reached.torque += torque;
            }
            if let Some(left) = points.last().cloned() {
                let from = points.len() - 1;
                points.extend((from + 1..stop).map(|point| {
                    let part = path.part(point, [from, stop]);
                    PathPoint::between(&left, &reached, part)
                }));
            }
            points.push(reached);
        }
        let (goes_on, stops) = (from.is_some(), path.stops.len());
        Ok(PathPrediction { points, goes_on, stops, calibration: self.calibration.clone() })
    }

    /// Torque of the elastic body at every stop, n_joints, N·m; empty if there is no body.
    fn torques_of_body(
        &self,
        path: &CheckedPath<'_>,
        waypoints: &Waypoints,
        goes_on: bool,
    ) -> Vec<DVector<f64>> {
        let Some(mut body) = self.body.clone() else { return Vec::new() };
        if !goes_on {
            body.begin_touch();
        }
        let (mut bent, mut torques) = (0, Vec::with_capacity(path.stops.len()));
        for (&at, &stop) in waypoints.stops.iter().zip(&path.stops) {
            // Several stops may share a waypoint.
            waypoints.poses[bent..=at].iter().for_each(|links| body.bend(links, None));
            bent = at + 1;
            torques.push(body.torque(path.poses(stop)));
        }
        torques
    }

    /// Whether a path starts close enough to the present position of the arm.
    fn starts_at(
        &self,
        (q, contact_state): &(Vec<f64>, Arc<ContactState>),
        path: &CheckedPath<'_>,
    ) -> bool {
        let path_length_m =
            self.checker.substeps().path_length_m((q, &contact_state.poses), path.at(0));
        path_length_m.is_ok_and(|path_length_m| path_length_m <= path.start_m)
    }

    /// The waypoints of a path, starting at `from`, the present position, or else at the first stop.
    fn waypoints(
        &self,
        path: &CheckedPath<'_>,
        from: Option<&(Vec<f64>, Arc<ContactState>)>,
    ) -> Result<Waypoints, PathError> {
        let mut before = match from {
            Some((q, contact_state)) => (&q[..], &contact_state.poses[..]),
            None => path.at(path.stops[0]),
        };
        let stops = Vec::with_capacity(path.stops.len());
        let mut waypoints = Waypoints { poses: vec![before.1.to_vec()], stops };
        for &stop in &path.stops {
            let here = path.at(stop);
            let between = self.checker.substeps().between(before, here);
            for poses in between.map_err(|error| PathError::at(stop, error))? {
                waypoints.go(&poses);
            }
            waypoints.go(here.1);
            waypoints.stops.push(waypoints.poses.len() - 1);
            if waypoints.stops.last() > Some(&(2 * MAX_STOPS)) {
                return Err(PathError::TooLong { point: stop, most: MAX_STOPS });
            }
            before = here;
        }
        Ok(waypoints)
    }

    /// The wrenches of all springs on the links, at every stop; where several stops share a waypoint, at
    /// the first of them.
    fn wrenches(
        &self,
        waypoints: &Waypoints,
        state: Option<Arc<ContactState>>,
        inside: bool,
    ) -> LinkWrenches {
        let surfaces = Arc::clone(&self.arm.surfaces);
        let (links, stops) = (surfaces.len(), waypoints.stops.len());
        let (lattice, coarse) = (self.springs.lattice().clone(), self.springs.are_clusters());
        let known_empty = self.contact.known_empty && !inside;
        let contact = ContactConfig { known_empty, ..self.contact.clone() };
        let poses = &waypoints.poses;
        let trajectory = PosedTrajectory::new(lattice, surfaces, &contact, coarse, state, poses);
        let mut stop_at = vec![None; poses.len()];
        waypoints.stops.iter().enumerate().rev().for_each(|(stop, &at)| stop_at[at] = Some(stop));
        let (bricks, springs) = (trajectory.bricks(), Arc::clone(&self.springs));
        let chunks = (CHUNKS * FEW_STOPS / stops).clamp(FEW_CHUNKS, CHUNKS);
        let of_chunk = move |chunk: usize| {
            let mut simulator = PathContactSimulator::new(&trajectory);
            let mut followed = Vec::new();
            let [first, end] = [chunk, chunk + 1].map(|chunk| chunk * bricks.len() / chunks);
            for brick in &bricks[first..end] {
                for (place, spring) in springs.of_brick(brick.low) {
                    simulator.add(brick, place, &(spring.offset * springs.lattice().spacing_m()));
                    followed.push(spring);
                }
            }
            let mut wrenches = LinkWrenches::nothing(stops, links);
            simulator.follow(&stop_at, |stop, simulator, displaced| {
                let index = displaced.index;
                wrenches.add(stop, &followed[index], simulator.rest(index), &displaced);
            });
            wrenches
        };
        let sum = in_chunks(chunks, of_chunk).into_iter().reduce(|mut sum, chunk| {
            sum.merge(chunk);
            sum
        });
        sum.expect("there is more than one chunk")
    }
}

/// The waypoints of the arm.
struct Waypoints {
    /// The links' poses, by waypoint and by link.
    poses: Vec<Vec<Isometry3<f64>>>,
    /// The numbers of the waypoints where the arm stops, by stop.
    stops: Vec<usize>,
}

impl Waypoints {
    /// Adds a waypoint, unless the arm is already there.
    fn go(&mut self, poses: &[Isometry3<f64>]) {
        if self.poses.last().is_none_or(|last| last != poses) {
            self.poses.push(poses.to_vec());
        }
    }
}
