//! Touches that go along the path of one that the field has learnt: what was felt then is the best prediction of what is
//! felt now, however well the field predicts.
//!
//! A frame of the new touch is matched with one of the old, in the same order, so that the links are as close together as
//! can be. Where the paths differ a little, the field says by how much the torque does:
//!
//! ```text
//! expected = τ then + τ̂ now − τ̂ then
//! ```

use nalgebra::{DVector, Isometry3};
use palpate::{Arm, Field};

use crate::calibrate::PredictedFrame;
use crate::error::{LearnError, Stop, unless_stopped};
use crate::field_rows::FieldRows;
use crate::tracked::{Tracked, TrackedFrame, TrackedTouch};

/// The touches that a field has learnt.
pub struct Learnt {
    touches: Vec<LearntTouch>,
    /// How far apart the links may be for a frame to be the same, m.
    close_m: f64,
}

struct LearntTouch {
    name: String,
    poses: Vec<Vec<Isometry3<f64>>>,
    /// τ − τ̂ of each pose, n_joints, N·m.
    beyond: Vec<DVector<f64>>,
}

/// A touch that repeats another.
pub(super) struct Repeated {
    /// The one that it repeats.
    pub(super) name: String,
    /// Its frames in contact, with what is expected in place of what the field predicts.
    pub(super) frames: Vec<PredictedFrame>,
}

/// Frames of a touch that are matched, about.
const MATCHED: usize = 150;
/// The share of them that must be close.
const CLOSE: f64 = 0.9;

impl Learnt {
    /// Touches tracked under the lattice and contact model of the field that has learnt them.
    pub fn new(arm: &Arm, tracked: &Tracked, field: &Field, untouched_std_n_per_m: f64) -> Self {
        let rows = FieldRows::of(tracked, field, untouched_std_n_per_m);
        let of = |touch: &TrackedTouch| {
            let some: Vec<&TrackedFrame> =
                touch.frames.iter().step_by(every(touch.frames.len())).collect();
            let beyond = |frame: &&TrackedFrame| {
                frame.observation.tau() - DVector::from_vec(rows.predicted(frame).torque)
            };
            LearntTouch {
                name: touch.name.clone(),
                poses: some.iter().map(|frame| poses(arm, &frame.q)).collect(),
                beyond: some.iter().map(beyond).collect(),
            }
        };
        let touches = tracked.touches.iter().filter(|touch| !touch.frames.is_empty());
        Self { touches: touches.map(of).collect(), close_m: field.lattice.spacing_m() }
    }

    /// The learnt touch along whose path a touch goes where it is in contact, if there is one; `predicted` is what the
    /// field says of these frames.
    pub(super) fn repeated(
        &self,
        arm: &Arm,
        touch: &TrackedTouch,
        predicted: &[PredictedFrame],
        stop: Stop<'_>,
    ) -> Result<Option<Repeated>, LearnError> {
        if predicted.is_empty() {
            return Ok(None);
        }
        let every = every(predicted.len());
        let now: Vec<_> =
            touch.in_contact().step_by(every).map(|frame| poses(arm, &frame.q)).collect();
        let matches = self.touches.iter().map(|learnt| {
            unless_stopped(stop)?;
            Ok((learnt, matched(arm, &now, &learnt.poses)))
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
        Ok(Some(Repeated { name: learnt.name.clone(), frames }))
    }
}

/// Every how many frames are matched.
fn every(frames: usize) -> usize {
    frames.div_ceil(MATCHED).max(1)
}

fn poses(arm: &Arm, q: &[f64]) -> Vec<Isometry3<f64>> {
    arm.robot.forward(q).expect("it was tracked").world_from_link
}

/// For each pose of a path the pose of another that it is matched with, and how far apart the links are, m: the later
/// the one, the later the other, and as close together as can be in sum. Empty if the other is.
fn matched(
    arm: &Arm,
    now: &[Vec<Isometry3<f64>>],
    then: &[Vec<Isometry3<f64>>],
) -> Vec<(usize, f64)> {
    let apart_m: Vec<Vec<f64>> =
        now.iter().map(|now| then.iter().map(|then| arm.travel_m(now, then)).collect()).collect();
    // The least sum up to each pair, and the pair before it.
    let mut least = vec![0.0; then.len()];
    let mut before: Vec<Vec<usize>> = Vec::with_capacity(now.len());
    for row in &apart_m {
        let (mut best, mut from) = (0, Vec::with_capacity(then.len()));
        for place in 0..then.len() {
            if least[place] < least[best] {
                best = place;
            }
            from.push(best);
        }
        least = from.iter().zip(row).map(|(&best, apart_m)| least[best] + apart_m).collect();
        before.push(from);
    }
    let Some(mut place) = (0..then.len()).min_by(|a, b| least[*a].total_cmp(&least[*b])) else {
        return Vec::new();
    };
    let mut matches = Vec::with_capacity(now.len());
    for (row, from) in apart_m.iter().zip(&before).rev() {
        matches.push((place, row[place]));
        place = from[place];
    }
    matches.reverse();
    matches
}
