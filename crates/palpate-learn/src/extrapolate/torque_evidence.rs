//! What the joints felt, as evidence about a stiffness over features.
//!
//! Torque is linear in stiffness: if every cell at a seen point has `K = φ(x)·w + 3c`, and all others
//! one stiffness of their own, then `τ = H K = (H Φ) (w, c, k)`, a few dozen unknowns that hundreds of
//! frames speak of. So colours are told apart by the torques themselves, and not by the stiffness of
//! single cells, of which no one knows which of them gave way.
//!
//! Frames of a touch resemble each other. All of a touch together count as much as one frame.

use nalgebra::{DMatrix, DVector};
use palpate::unstable::{Cell, Stiffness};
use rayon::prelude::*;

use super::process::{Evidence, Posterior, Process};
use crate::tracked::{Tracked, TrackedTouch};

/// The evidence of every touch, over `(w, c, k)`.
pub(super) fn evidence(tracked: &Tracked, process: &Process, at: &[Option<u32>]) -> Vec<Evidence> {
    let seen: Vec<u32> = at.iter().filter_map(|at| *at).collect();
    let unknowns = process.len() + 1;
    let columns: Vec<Vec<Vec<f64>>> = (0..unknowns)
        .into_par_iter()
        .map(|unknown| {
            let mut values = Vec::new();
            if unknown < process.len() {
                values = process.covariance_with(unknown, &seen);
            }
            let mut values = values.into_iter();
            let stiffness = |at: &Option<u32>| match at {
                Some(_) => values.next().unwrap_or(0.0),
                None => f64::from(u8::from(unknown == process.len())),
            };
            let cells: Vec<Cell> = (tracked.points_m.iter().zip(at.iter().map(stiffness)))
                .map(|(&point, k)| Cell::new(point, k))
                .collect();
            tracked.touches.iter().map(|touch| torques(touch, &cells)).collect()
        })
        .collect();
    let of = |(number, touch): (usize, &TrackedTouch)| {
        let columns: Vec<&[f64]> = columns.iter().map(|column| &column[number][..]).collect();
        process.whitened(of_touch(touch, &columns))
    };
    tracked.touches.iter().enumerate().map(of).collect()
}

/// What some touches say together.
pub(super) fn posterior(touches: &[&Evidence], prior_std: f64, torque_std: f64) -> Posterior {
    let mut all = Evidence::none(touches.first().map_or(0, |touch| touch.moment.len()));
    touches.iter().for_each(|touch| all.add(touch));
    Posterior::new(&all, prior_std, torque_std)
}

/// Torques of all frames in contact under a stiffness that is nowhere negative, N·m.
fn torques(touch: &TrackedTouch, cells: &[Cell]) -> Vec<f64> {
    let mut torques = Vec::new();
    for frame in touch.frames.iter().filter(|frame| frame.observation.n_contacts() > 0) {
        let tau = frame.observation.predict(cells, Stiffness::Positive);
        torques.extend_from_slice(tau.as_slice());
    }
    torques
}

/// The sums of a touch, as if it were one frame.
fn of_touch(touch: &TrackedTouch, columns: &[&[f64]]) -> Evidence {
    let in_contact = touch.frames.iter().filter(|frame| frame.observation.n_contacts() > 0);
    let mut tau = Vec::new();
    for frame in in_contact.clone() {
        tau.extend(frame.observation.tau().iter());
    }
    let frames = in_contact.count();
    if frames == 0 {
        return Evidence::none(columns.len());
    }
    let share = (frames as f64).recip();
    let a = DMatrix::from_fn(tau.len(), columns.len(), |reading, column| columns[column][reading]);
    let tau = DVector::from_vec(tau);
    Evidence {
        gram: a.tr_mul(&a) * share,
        moment: a.tr_mul(&tau) * share,
        power: tau.norm_squared() * share,
        readings: tau.len() as f64 * share,
    }
}
