//! Wrenches of the springs on the links at the stops of a path, and torques between two stops.
//!
//! A spring at rest point p, displaced by u, pushes its link with the wrench `−K s`, `s = (u, p × u)` about the world's
//! origin ([`crate::torque`]). Only the sums of `K s`, `σ² s sᵀ` and `K² s sᵀ` over the springs of a link are needed:
//! the spatial Jacobian J of the link converts them to torques and variances.

use nalgebra::{DVector, Matrix6, Point3, Vector6};

use super::PathPoint;
use super::springs::Spring;
use crate::contact::Displaced;
use crate::robot::{LinkId, Poses, Robot};

/// Sums over all springs on one link at one stop.
#[derive(Debug, Clone)]
struct Push {
    /// `Σ K s`: force, N, and moment about the world's origin, N·m, on the springs.
    wrench: Vector6<f64>,
    /// `Σ σ² s sᵀ`, lower triangle only.
    covariance: Matrix6<f64>,
    /// `Σ K² s sᵀ`, lower triangle only.
    squares: Matrix6<f64>,
}

/// Sums over some of the springs, for all links and all stops of a path.
#[derive(Debug, Clone)]
pub(super) struct LinkWrenches {
    /// By link, and by stop; empty for a link that touches nothing.
    pushes: Vec<Vec<Push>>,
    /// Number of touched cells, and of known ones among them, by stop; estimates in a coarse predictor.
    counts: Vec<[f64; 2]>,
}

impl Push {
    fn nothing() -> Self {
        Self { wrench: Vector6::zeros(), covariance: Matrix6::zeros(), squares: Matrix6::zeros() }
    }
}

impl LinkWrenches {
    /// Zero sums for `stops` stops and `links` links.
    pub(super) fn nothing(stops: usize, links: usize) -> Self {
        Self { pushes: vec![Vec::new(); links], counts: vec![[0.0; 2]; stops] }
    }

    /// Adds a spring that is displaced at a stop, from its rest point.
    pub(super) fn add(
        &mut self,
        stop: usize,
        spring: &Spring,
        rest: &Point3<f64>,
        displaced: &Displaced,
    ) {
        let (u, moment) = (displaced.displacement_m, rest.coords.cross(&displaced.displacement_m));
        let s = Vector6::new(u.x, u.y, u.z, moment.x, moment.y, moment.z);
        let pushes = &mut self.pushes[displaced.link.index()];
        if pushes.is_empty() {
            pushes.resize(self.counts.len(), Push::nothing());
        }
        let Push { wrench, covariance, squares } = &mut pushes[stop];
        *wrench += spring.stiffness_n_per_m * s;
        for column in 0..6 {
            let factors = [spring.variance * s[column], spring.square * s[column]];
            for row in column..6 {
                covariance[(row, column)] += factors[0] * s[row];
                squares[(row, column)] += factors[1] * s[row];
            }
        }
        self.counts[stop][0] += spring.stands_for;
        self.counts[stop][1] += if spring.is_known { spring.stands_for } else { 0.0 };
    }

    /// Adds the sums over other springs at the same stops.
    pub(super) fn merge(&mut self, other: Self) {
        for (ours, theirs) in self.pushes.iter_mut().zip(other.pushes) {
            if ours.is_empty() {
                *ours = theirs;
                continue;
            }
            for (ours, theirs) in ours.iter_mut().zip(theirs) {
                ours.wrench += theirs.wrench;
                ours.covariance += theirs.covariance;
                ours.squares += theirs.squares;
            }
        }
        for (ours, theirs) in self.counts.iter_mut().zip(other.counts) {
            *ours = [ours[0] + theirs[0], ours[1] + theirs[1]];
        }
    }

    /// The prediction at a stop, where the links have these poses.
    pub(super) fn point(&self, stop: usize, robot: &Robot, poses: &Poses) -> PathPoint {
        let mut torque = DVector::zeros(robot.n_joints());
        let [mut variance, mut square] = [(); 2].map(|()| DVector::zeros(robot.n_joints()));
        for (link, pushes) in self.pushes.iter().enumerate() {
            let Some(Push { wrench, covariance, squares }) = pushes.get(stop) else { continue };
            let spatial = robot.spatial_jacobian(poses, LinkId(link as u16));
            let (mut covariance, mut squares) = (*covariance, *squares);
            covariance.fill_upper_triangle_with_lower_triangle();
            squares.fill_upper_triangle_with_lower_triangle();
            for (joint, column) in spatial.column_iter().enumerate() {
                torque[joint] -= column.dot(wrench);
                variance[joint] += column.dot(&(covariance * column));
                square[joint] += column.dot(&(squares * column));
            }
        }
        let [contacts, known] = self.counts[stop].map(|cells| cells.round() as usize);
        let root = |sum: f64| sum.max(0.0).sqrt();
        let (torque_std, torque_rss) = (variance.map(root), square.map(root));
        PathPoint { torque, torque_std, torque_rss, contacts, known }
    }
}

impl PathPoint {
    /// Interpolates between two stops; `part` is the share of the path length, 0 to 1.
    pub(super) fn between(from: &Self, to: &Self, part: f64) -> Self {
        let count = |from: usize, to: usize| {
            (from as f64 + part * (to as f64 - from as f64)).round() as usize
        };
        Self {
            torque: from.torque.lerp(&to.torque, part),
            torque_std: from.torque_std.lerp(&to.torque_std, part),
            torque_rss: from.torque_rss.lerp(&to.torque_rss, part),
            contacts: count(from.contacts, to.contacts),
            known: count(from.known, to.known),
        }
    }
}
