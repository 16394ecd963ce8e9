//! Evidence of measured torques about a stiffness over features.
//!
//! Torque is linear in stiffness: if every cell at a seen point has `K = φ(x)·w + 3c`, and all other
//! cells share one stiffness k, then `τ = H K = (H Φ) (w, c, k)`: a few dozen unknowns, and hundreds
//! of frames. So colours are distinguished by the torques directly, and not by the stiffness of
//! single cells, which torques determine badly.
//!
//! Frames of a touch resemble each other, so all frames of a touch together count as one frame.

use nalgebra::{DMatrix, DVector};
use palpate::unstable::CellState;
use rayon::prelude::*;

use super::process::{Evidence, Posterior, Process};
use crate::tracked::{TrackedTouch, TrackedTouches};

/// The evidence of every touch, over `(w, c, k)`.
pub(super) fn evidence(
    tracked: &TrackedTouches,
    process: &Process,
    at: &[Option<u32>],
) -> Vec<Evidence> {
    let seen: Vec<u32> = at.iter().filter_map(|at| *at).collect();
    let unknowns = process.len() + 1;
    let columns: Vec<Vec<Vec<f64>>> = (0..unknowns)
        .into_par_iter()
        .map(|unknown| {
            let of_cloud = unknown < process.len();
            let values =
                if of_cloud { process.covariance_with(unknown, &seen) } else { Vec::new() };
            let mut values = values.into_iter();
            let cells = tracked.with_stiffness(|row| match at[row] {
                Some(_) => values.next().unwrap_or(0.0),
                None => f64::from(u8::from(!of_cloud)),
            });
            tracked.touches.iter().map(|touch| torques(touch, &cells)).collect()
        })
        .collect();
    let of = |(number, touch): (usize, &TrackedTouch)| {
        let columns: Vec<&[f64]> = columns.iter().map(|column| &column[number][..]).collect();
        process.whitened(of_touch(touch, &columns))
    };
    tracked.touches.iter().enumerate().map(of).collect()
}

/// The posterior of `(w, c, k)` given the evidence of several touches.
pub(super) fn posterior(touches: &[&Evidence], prior_std: f64, torque_std: f64) -> Posterior {
    let mut all = Evidence::none(touches.first().map_or(0, |touch| touch.moment.len()));
    touches.iter().for_each(|touch| all.add(touch));
    Posterior::new(&all, prior_std, torque_std)
}

/// Predicted torques of all frames in contact, one after the other, N·m.
fn torques(touch: &TrackedTouch, cells: &[CellState]) -> Vec<f64> {
    touch.in_contact().flat_map(|frame| frame.predict(cells)).collect()
}

/// The sums of a touch, divided by its number of frames in contact, so that it counts as one frame.
fn of_touch(touch: &TrackedTouch, columns: &[&[f64]]) -> Evidence {
    let frames = touch.frames_in_contact();
    if frames == 0 {
        return Evidence::none(columns.len());
    }
    let share = (frames as f64).recip();
    let tau = touch.in_contact().flat_map(|frame| frame.observation.tau().as_slice().to_vec());
    let tau = DVector::from_vec(tau.collect());
    let a = DMatrix::from_fn(tau.len(), columns.len(), |reading, column| columns[column][reading]);
    Evidence {
        gram: a.tr_mul(&a) * share,
        moment: a.tr_mul(&tau) * share,
        power: tau.norm_squared() * share,
        readings: tau.len() as f64 * share,
    }
}
