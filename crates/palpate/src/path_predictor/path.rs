//! Paths: their points, the path length between them, and their stops.

use super::{MAX_POINTS, MAX_STOPS, PathConfig, PathError};
use crate::motion::{Substeps, Waypoint};
use crate::robot::Poses;

/// Share of the resolution by which the arm must move back for its farthest point to become a stop; smaller motions may
/// be noise of the sensors.
const TURNS_ROUND: f64 = 0.03;

/// Checks paths and finds their stops; needs no field.
#[derive(Debug, Clone)]
pub struct PathChecker {
    substeps: Substeps,
    /// Spacing of the lattice, m.
    spacing_m: f64,
}

/// A path that has passed the checks.
#[derive(Debug)]
pub struct CheckedPath<'a> {
    q: Vec<&'a [f64]>,
    poses: Vec<Poses>,
    /// Path length of the fastest point of the arm up to each point of the path, m.
    along_m: Vec<f64>,
    /// The points where the arm stops.
    pub(super) stops: Vec<usize>,
    /// Largest distance of its first point from the present position of the arm for the path to continue from the
    /// contacts there, m.
    pub(super) start_m: f64,
    /// [`PathConfig::inside`].
    pub(super) inside: bool,
}

impl PathChecker {
    pub(crate) fn new(substeps: Substeps, spacing_m: f64) -> Self {
        Self { substeps, spacing_m }
    }

    /// Number of joint positions of each point of a path.
    pub fn n_joints(&self) -> usize {
        self.substeps.robot().n_joints()
    }

    /// The first point of a path in which a joint exceeds its limits by more than `margin`, rad or m: the number of the
    /// point, the number of the joint, and the limits.
    pub fn beyond_limits<Q: AsRef<[f64]>>(
        &self,
        path: &[Q],
        margin: f64,
    ) -> Option<(usize, usize, [f64; 2])> {
        let joints = self.substeps.robot().joints();
        let beyond = |(point, q): (usize, &Q)| {
            let mut positions = joints.iter().zip(q.as_ref()).enumerate();
            positions.find_map(|(number, (joint, &position))| {
                let [low, high] = joint.range?;
                let is_beyond = position < low - margin || position > high + margin;
                is_beyond.then_some((point, number, [low, high]))
            })
        };
        path.iter().enumerate().find_map(beyond)
    }

    pub(super) fn substeps(&self) -> &Substeps {
        &self.substeps
    }

    /// Checks a path: n_joints positions (rad, m where prismatic) for each point. Joints move linearly from one point
    /// to the next, angles the shorter way round.
    ///
    /// Cost: some 3 µs for each point.
    ///
    /// # Errors
    ///
    /// If the path is empty, too long, or has a point that does not fit the robot.
    pub fn check<'a, Q: AsRef<[f64]>>(
        &self,
        path: &'a [Q],
        config: &PathConfig,
    ) -> Result<CheckedPath<'a>, PathError> {
        config.check()?;
        let start_m = config.start_cells * self.spacing_m;
        let mut checked = CheckedPath::new(&self.substeps, path, (start_m, config.inside))?;
        checked.stops =
            checked.find_stops(&self.substeps, config.resolution_cells * self.spacing_m);
        match checked.stops.get(MAX_STOPS) {
            Some(&point) => Err(PathError::TooLong { point, most: MAX_STOPS }),
            None => Ok(checked),
        }
    }
}

impl<'a> CheckedPath<'a> {
    /// A path whose stops are not determined yet.
    fn new<Q: AsRef<[f64]>>(
        substeps: &Substeps,
        path: &'a [Q],
        (start_m, inside): (f64, bool),
    ) -> Result<Self, PathError> {
        if path.is_empty() {
            return Err(PathError::Empty);
        }
        if path.len() > MAX_POINTS {
            return Err(PathError::TooManyPoints { found: path.len() });
        }
        let q: Vec<&[f64]> = path.iter().map(AsRef::as_ref).collect();
        let poses = q.iter().enumerate().map(|(point, q)| {
            let reason = |reason| PathError::Point { point, reason };
            substeps.robot().forward(q).map_err(reason)
        });
        let poses: Vec<Poses> = poses.collect::<Result<_, _>>()?;
        let (mut along_m, longest_m) = (vec![0.0], MAX_STOPS as f64 * substeps.substep_m());
        for point in 1..q.len() {
            let [from, to] = [point - 1, point].map(|n| (q[n], &poses[n].world_from_link[..]));
            let path_length_m =
                substeps.path_length_m(from, to).map_err(|error| PathError::at(point, error))?;
            along_m.push(along_m[point - 1] + path_length_m);
            if along_m[point].is_nan() || along_m[point] > longest_m {
                return Err(PathError::TooLong { point, most: MAX_STOPS });
            }
        }
        Ok(Self { q, poses, along_m, stops: Vec::new(), start_m, inside })
    }

    /// Joint positions and poses of the arm at a point.
    pub(super) fn at(&self, point: usize) -> Waypoint<'_> {
        (self.q[point], &self.poses[point].world_from_link)
    }

    pub(super) fn poses(&self, point: usize) -> &Poses {
        &self.poses[point]
    }

    /// Where a point is on the way between two others, as a share (0 to 1) of the path length.
    pub(super) fn part(&self, point: usize, [from, to]: [usize; 2]) -> f64 {
        let path_length_m = self.along_m[to] - self.along_m[from];
        if path_length_m > 0.0 {
            (self.along_m[point] - self.along_m[from]) / path_length_m
        } else {
            0.0
        }
    }

    /// The stops, between which the arm moves by at most `resolution_m` where points are close enough.
    fn find_stops(&self, substeps: &Substeps, resolution_m: f64) -> Vec<usize> {
        let last = self.q.len() - 1;
        if resolution_m == 0.0 {
            return (0..=last).collect();
        }
        let from_to =
            |from: usize, to: usize| substeps.chord_length_m(self.at(from).1, self.at(to).1);
        let (mut stops, mut stop) = (vec![0], 0);
        while stop < last {
            let (mut next, mut farthest) = (stop + 1, (stop + 1, from_to(stop, stop + 1)));
            while next < last && self.along_m[next + 1] - self.along_m[stop] <= resolution_m {
                next += 1;
                let path_length_m = from_to(stop, next);
                if path_length_m > farthest.1 {
                    farthest = (next, path_length_m);
                } else if path_length_m < farthest.1 - TURNS_ROUND * resolution_m {
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
