//! Regularises radii towards the common taper of branches of the same order.
//!
//! Bending stiffness grows with the fourth power of the radius, and a branch that is half hidden looks
//! half as thick, so the width of a single branch is not reliable.

use nalgebra::Vector2;

use super::tubes::{Tube, fit_line};
use crate::upper_median::upper_median;

/// At this length, m, a branch's own radius has a weight of 0.25 against the common taper; for longer branches the
/// weight approaches 0.5.
const HALF_LENGTH_M: f64 = 0.04;
/// Tubes that a stem carries count as branches if they are longer than this, m; all others as twigs.
const BRANCH_M: f64 = 0.08;

/// Order of a branch. Branches of the same order share a taper.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Order {
    Stem,
    Branch,
    Twig,
}

/// Regularises the radii of branches and twigs towards their common taper; stems keep theirs.
///
/// `carriers`: for each tube, the index of the tube that carries it, if any.
pub(super) fn draw_together(tubes: &mut [Tube], carriers: &[Option<usize>]) {
    let arcs: Vec<Vec<f64>> = tubes.iter().map(Tube::arc_m).collect();
    let length = |at: usize| arcs[at][arcs[at].len() - 1];
    let order = |at: usize| match carriers[at] {
        None => Order::Stem,
        Some(carrier) if carriers[carrier].is_none() && length(at) > BRANCH_M => Order::Branch,
        Some(_) => Order::Twig,
    };
    for wanted in [Order::Branch, Order::Twig] {
        let these: Vec<usize> = (0..tubes.len()).filter(|&at| order(at) == wanted).collect();
        if these.is_empty() {
            continue;
        }
        let share = |at: usize, arc: f64| arc / f64::max(length(at), 0.02);
        let (mut places, mut radii) = (Vec::new(), Vec::new());
        for &at in &these {
            places.extend(arcs[at].iter().map(|&arc| share(at, arc)));
            radii.extend(tubes[at].radii.iter().copied());
        }
        let line = robust_line(&places, &radii);
        for &at in &these {
            let own = 0.5 * length(at) / (length(at) + HALF_LENGTH_M);
            for (radius, &arc) in tubes[at].radii.iter_mut().zip(&arcs[at]) {
                let common = f64::max(line[0] + line[1] * share(at, arc), 0.0016);
                *radius = (own * radius.ln() + (1.0 - own) * common.ln()).exp();
            }
        }
    }
}

/// Offset and slope of a robust line through the radii.
fn robust_line(places: &[f64], radii: &[f64]) -> Vector2<f64> {
    let mut line = Vector2::new(upper_median(&mut radii.to_vec()).unwrap_or(0.0), 0.0);
    for _ in 0..20 {
        let weight = |(place, radius): (&f64, &f64)| {
            1.0 / (1.0 + ((radius - line[0] - line[1] * place) / 8e-4).powi(2))
        };
        let weights: Vec<f64> = places.iter().zip(radii).map(weight).collect();
        line = fit_line(places, radii, &weights);
    }
    line
}
