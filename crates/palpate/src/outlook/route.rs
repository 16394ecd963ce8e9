//! The points of a path, how far apart they are, and at which of them the arm stops.

use super::{MAX_MOTIONS, MAX_POINTS, PathError};
use crate::follow::Follower;
use crate::robot::Poses;

/// The share of a resolution that the arm must go back for its farthest point to be a stop; less
/// may be a sensor's noise.
const TURNS_ROUND: f64 = 0.1;

/// A path that was found fit to be followed.
pub(super) struct Route<'a> {
    q: Vec<&'a [f64]>,
    poses: Vec<Poses>,
    /// How far the fastest point of the arm has gone at each point of the path, m.
    along_m: Vec<f64>,
}

impl<'a> Route<'a> {
    pub(super) fn new<Q: AsRef<[f64]>>(arm: &Follower, path: &'a [Q]) -> Result<Self, PathError> {
        if path.is_empty() {
            return Err(PathError::Empty);
        }
        if path.len() > MAX_POINTS {
            return Err(PathError::TooManyPoints { found: path.len() });
        }
        let q: Vec<&[f64]> = path.iter().map(AsRef::as_ref).collect();
        let poses = q.iter().enumerate().map(|(point, q)| {
            let reason = |reason| PathError::Point { point, reason };
            arm.arm().robot.forward(q).map_err(reason)
        });
        let poses: Vec<Poses> = poses.collect::<Result<_, _>>()?;
        let (mut along_m, longest_m) =
            (vec![0.0], MAX_MOTIONS as f64 * arm.simulator().substep_m());
        for point in 1..q.len() {
            let [from, to] = [point - 1, point].map(|point| (q[point], &poses[point]));
            let way_m = arm.way_m(from, to).map_err(|lost| PathError::at(point, lost))?;
            along_m.push(along_m[point - 1] + way_m);
            if along_m[point].is_nan() || along_m[point] > longest_m {
                return Err(PathError::TooLong { point });
            }
        }
        Ok(Self { q, poses, along_m })
    }

    pub(super) fn at(&self, point: usize) -> (&'a [f64], &Poses) {
        (self.q[point], &self.poses[point])
    }

    /// The part (0 to 1) of the way between two points that a third has made.
    pub(super) fn part(&self, point: usize, [from, to]: [usize; 2]) -> f64 {
        let way_m = self.along_m[to] - self.along_m[from];
        if way_m > 0.0 { (self.along_m[point] - self.along_m[from]) / way_m } else { 0.0 }
    }

    /// The points where the arm stops.
    pub(super) fn stops(&self, arm: &Follower, resolution_m: f64) -> Vec<usize> {
        let last = self.q.len() - 1;
        if resolution_m == 0.0 {
            return (0..=last).collect();
        }
        let from_to = |from: usize, to: usize| {
            let [from, to] = [from, to].map(|point| &self.poses[point].world_from_link[..]);
            arm.simulator().travel_m(from, to)
        };
        let (mut stops, mut stop) = (vec![0], 0);
        while stop < last {
            let (mut next, mut farthest) = (stop + 1, (stop + 1, from_to(stop, stop + 1)));
            while next < last && self.along_m[next + 1] - self.along_m[stop] <= resolution_m {
                next += 1;
                let way_m = from_to(stop, next);
                if way_m > farthest.1 {
                    farthest = (next, way_m);
                } else if way_m < farthest.1 - TURNS_ROUND * resolution_m {
                    next = farthest.0;
                    break;
                }
            }
            stop = next;
            stops.push(stop);
        }
        stops
    }
}
