//! Touches that repeat the path of a learnt touch: the earlier measured torque is then the best prediction, however
//! well the field predicts.
//!
//! Each frame of the new touch is matched with one of the earlier touch, in the same order, so that the sum of the
//! distances between the links is smallest. Where the paths differ a little, the field corrects the torque:
//!
//! ```text
//! expected = τ then + τ̂ now − τ̂ then
//! ```
//!
//! If the object was moved in between, the arm meets it at another place of the path. So to test a motion, frames are
//! matched by the position of the arm relative to the object: the contact point is as close as possible to the earlier
//! one. τ̂ now is that of the moved field.

use nalgebra::{DVector, Isometry3, Point3, Vector3};
use palpate::{Arm, Field};

use crate::calibrate::PredictedFrame;
use crate::error::{LearnError, Stop, unless_stopped};
use crate::field_estimates::FieldEstimates;
use crate::tracked::{TrackedFrame, TrackedTouch, TrackedTouches};

use super::moved::ObjectMotion;

/// The touches that a field has learnt.
pub(super) struct Learnt {
    touches: Vec<LearntTouch>,
    /// Largest distance between the links of matched frames that counts as the same pose, m.
    close_m: f64,
}

struct LearntTouch {
    name: String,
    contact: ContactPoint,
    poses: Vec<Vec<Isometry3<f64>>>,
    /// Residual τ − τ̂ of the field at each pose, n_joints, N·m.
    beyond: Vec<DVector<f64>>,
}

/// The point of a link that touches the object.
struct ContactPoint {
    /// Index of the link.
    link: usize,
    /// Position, m, link frame.
    point: Point3<f64>,
}

impl ContactPoint {
    /// The contact point in the frame with the largest torque: the mean of the touched cells, weighted by their
    /// stiffness, on the link nearest to it. `None` without contact.
    fn of(
        arm: &Arm,
        touch: &TrackedTouch,
        tracked: &TrackedTouches,
        rows: &FieldEstimates,
    ) -> Option<Self> {
        let torque = |frame: &TrackedFrame| frame.observation.tau().norm();
        let most = touch.in_contact().max_by(|a, b| torque(a).total_cmp(&torque(b)))?;
        let (mut sum, mut total) = (Vector3::zeros(), 0.0);
        for row in most.observation.rows() {
            let weight = rows.estimates[row].stiffness_n_per_m + MIN_STIFFNESS_N_PER_M;
            sum += weight * Vector3::from(tracked.points_m[row]);
            total += weight;
        }
        let centre = Point3::from(sum / total);
        let poses = poses(arm, &most.q);
        let links = arm.surfaces.iter().zip(&poses).enumerate();
        let places = links.filter_map(|(link, (surface, pose))| {
            let point = pose.inverse_transform_point(&centre);
            Some((link, point, surface.as_ref()?.distance(&point)))
        });
        let (link, point, _) = places.min_by(|a, b| a.2.total_cmp(&b.2))?;
        Some(Self { link, point })
    }

    fn at(&self, poses: &[Isometry3<f64>]) -> Point3<f64> {
        poses[self.link] * self.point
    }
}

/// A touch that repeats another.
pub(super) struct Repeated<'a> {
    learnt: &'a LearntTouch,
    /// Its frames in contact; `torque` is the expected torque instead of the field's prediction.
    pub(super) frames: Vec<PredictedFrame>,
    /// Every n-th of these frames is matched; this is n.
    every: usize,
    /// Positions of the contact point in the matched frames, and in the frames of the earlier touch, m, world frame.
    places: [Vec<Point3<f64>>; 2],
}

impl Repeated<'_> {
    /// The name of the touch that it repeats.
    pub(super) fn name(&self) -> &str {
        &self.learnt.name
    }

    /// For each frame, the torque that the moved field should predict, n_joints, N·m: the measured torque minus the
    /// field's residual in the earlier frame at the same place of the object.
    pub(super) fn wanted(&self, motion: ObjectMotion) -> impl Iterator<Item = DVector<f64>> {
        let [now, then] = &self.places;
        let apart_m = |now: &Point3<f64>| {
            let before = motion.back(now);
            then.iter().map(|then| (before - then).norm()).collect()
        };
        let matches = matched(&now.iter().map(apart_m).collect::<Vec<_>>());
        self.frames.iter().enumerate().map(move |(number, frame)| {
            let beyond = &self.learnt.beyond[matches[number / self.every].0];
            DVector::from_column_slice(&frame.measured) - beyond
        })
    }
}

/// Most frames of a touch that are matched.
const MATCHED: usize = 150;
/// Smallest share of matched frames that must be close for a touch to be a repetition.
const CLOSE: f64 = 0.9;
/// Weight of a cell without stiffness in the contact point, N/m.
const MIN_STIFFNESS_N_PER_M: f64 = 1e-6;

impl Learnt {
    /// `tracked` are the learnt touches, under the lattice and contact model of the field.
    pub(super) fn new(
        arm: &Arm,
        tracked: &TrackedTouches,
        field: &Field,
        untouched_std_n_per_m: f64,
    ) -> Self {
        let rows = FieldEstimates::of(tracked, field, untouched_std_n_per_m);
        let of = |touch: &TrackedTouch| {
            let some: Vec<&TrackedFrame> =
                touch.frames.iter().step_by(every(touch.frames.len())).collect();
            let beyond = |frame: &&TrackedFrame| {
                frame.observation.tau() - DVector::from_vec(rows.predicted(frame).torque)
            };
            Some(LearntTouch {
                name: touch.name.clone(),
                contact: ContactPoint::of(arm, touch, tracked, &rows)?,
                poses: some.iter().map(|frame| poses(arm, &frame.q)).collect(),
                beyond: some.iter().map(beyond).collect(),
            })
        };
        let touches = tracked.touches.iter().filter_map(of).collect();
        Self { touches, close_m: field.lattice.spacing_m() }
    }

    /// Finds the learnt touch whose path a touch repeats while in contact; `predicted` are the field's predictions for
    /// its frames in contact.
    pub(super) fn repeated(
        &self,
        arm: &Arm,
        touch: &TrackedTouch,
        predicted: &[PredictedFrame],
        stop: Stop<'_>,
    ) -> Result<Option<Repeated<'_>>, LearnError> {
        if predicted.is_empty() {
            return Ok(None);
        }
        let every = every(predicted.len());
        let now: Vec<_> =
            touch.in_contact().step_by(every).map(|frame| poses(arm, &frame.q)).collect();
        let matches = self.touches.iter().map(|learnt| {
            unless_stopped(stop)?;
            let apart_m = |now: &Vec<Isometry3<f64>>| {
                learnt.poses.iter().map(|then| arm.travel_m(now, then)).collect()
            };
            Ok((learnt, matched(&now.iter().map(apart_m).collect::<Vec<_>>())))
        });
        let matches: Vec<_> = matches.collect::<Result<_, LearnError>>()?;
        let sum =
            |matches: &[(usize, f64)]| matches.iter().map(|(_, apart_m)| apart_m).sum::<f64>();
        let nearest = matches.iter().min_by(|a, b| sum(&a.1).total_cmp(&sum(&b.1)));
        let Some((learnt, matches)) = nearest else { return Ok(None) };
        let close = matches.iter().filter(|(_, apart_m)| *apart_m <= self.close_m).count();
        if (close as f64) < CLOSE * matches.len() as f64 {
            return Ok(None);
        }
        let expected = |(number, frame): (usize, &PredictedFrame)| {
            let beyond = &learnt.beyond[matches[number / every].0];
            let torque =
                frame.torque.iter().zip(beyond.iter()).map(|(torque, beyond)| torque + beyond);
            PredictedFrame { torque: torque.collect(), ..frame.clone() }
        };
        let frames = predicted.iter().enumerate().map(expected).collect();
        let places = [&now, &learnt.poses]
            .map(|poses| poses.iter().map(|poses| learnt.contact.at(poses)).collect());
        Ok(Some(Repeated { learnt, frames, every, places }))
    }
}

/// The n of matching every n-th frame.
fn every(frames: usize) -> usize {
    frames.div_ceil(MATCHED).max(1)
}

fn poses(arm: &Arm, q: &[f64]) -> Vec<Isometry3<f64>> {
    arm.robot.forward(q).expect("it was tracked").world_from_link
}

/// Matches the frames of two paths in monotonic order with the smallest sum of distances, by dynamic programming.
/// Returns for each frame of the first path the matched frame of the second, and their distance, m. `apart_m` are the
/// distances from each frame of the first path to each of the second. Empty if a path is empty.
fn matched(apart_m: &[Vec<f64>]) -> Vec<(usize, f64)> {
    let frames_then = apart_m.first().map_or(0, Vec::len);
    // The least sum of distances up to each pair, and the pair before it.
    let mut least = vec![0.0; frames_then];
    let mut before: Vec<Vec<usize>> = Vec::with_capacity(apart_m.len());
    for row in apart_m {
        let (mut best, mut from) = (0, Vec::with_capacity(frames_then));
        for place in 0..frames_then {
            if least[place] < least[best] {
                best = place;
            }
            from.push(best);
        }
        least = from.iter().zip(row).map(|(&best, apart_m)| least[best] + apart_m).collect();
        before.push(from);
    }
    let Some(mut place) = (0..frames_then).min_by(|a, b| least[*a].total_cmp(&least[*b])) else {
        return Vec::new();
    };
    let mut matches = Vec::with_capacity(apart_m.len());
    for (row, from) in apart_m.iter().zip(&before).rev() {
        matches.push((place, row[place]));
        place = from[place];
    }
    matches.reverse();
    matches
}
