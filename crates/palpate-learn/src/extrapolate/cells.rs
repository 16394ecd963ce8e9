//! Evidence of the stiffness of touched cells about a stiffness over features.
//!
//! A cell that was touched in n frames has the weight `n/(n + 20)`, so that a cell that was only
//! brushed counts less than one that was pressed often.

use std::collections::{HashMap, HashSet};

use palpate::{CellId, Field};

use super::cloud::SeenCloud;
use super::process::{Evidence, Process};

/// Number of frames that gives a cell a weight of ½.
const HALF_KNOWN: f64 = 20.0;

/// Weight of a cell that was touched in this number of frames, 0 to 1.
fn weight(frames: u32) -> f64 {
    f64::from(frames) / (f64::from(frames) + HALF_KNOWN)
}

/// The evidence of those touched cells, given by their rows in the field, that have a seen point
/// (`at`).
pub(super) fn evidence(
    field: &Field,
    process: &Process,
    rows: &[usize],
    at: &[Option<u32>],
) -> Evidence {
    let (rows, points): (Vec<usize>, Vec<usize>) =
        rows.iter().zip(at).filter_map(|(&row, at)| Some((row, (*at)? as usize))).unzip();
    let mut phi = process.phi(points.into_iter());
    let mut evidence = Evidence::none(process.len());
    for (mut column, &row) in phi.column_iter_mut().zip(&rows) {
        let (weight, k) = (weight(field.counts[row]), field.stiffness_n_per_m[row]);
        evidence.moment.axpy(weight * k, &column, 1.0);
        evidence.power += weight * k * k;
        evidence.readings += weight;
        column *= weight.sqrt();
    }
    evidence.gram = &phi * phi.transpose();
    evidence
}

/// For every seen point, the mean stiffness of the touched cells whose nearest point it is, N/m,
/// and their weight; otherwise that of the touched cell in which it lies; `None` without such a
/// cell.
pub(super) fn of_points(
    field: &Field,
    seen: &SeenCloud,
    (rows, at): (&[usize], &[Option<u32>]),
) -> Vec<Option<(f64, f64)>> {
    let mut sums = vec![(0.0, 0.0); seen.len()];
    for (&row, point) in rows.iter().zip(at) {
        if let Some(point) = *point {
            let weight = weight(field.counts[row]);
            let (sum, weights) = &mut sums[point as usize];
            *sum += weight * field.stiffness_n_per_m[row];
            *weights += weight;
        }
    }
    let by_cell: HashMap<CellId, usize> = rows.iter().map(|&row| (field.cells[row], row)).collect();
    let within = |point: &[f64; 3]| {
        let row = *by_cell.get(&field.lattice.nearest(&(*point).into())?)?;
        Some((field.stiffness_n_per_m[row], weight(field.counts[row])))
    };
    let of = |((sum, weight), point): (&(f64, f64), &[f64; 3])| {
        if *weight > 0.0 { Some((sum / weight, *weight)) } else { within(point) }
    };
    sums.iter().zip(seen.points_m()).map(of).collect()
}

/// Whether each seen point lies in a touched cell.
pub(super) fn touched(field: &Field, seen: &SeenCloud) -> Vec<bool> {
    let touched: HashSet<CellId> =
        field.cells.iter().zip(&field.counts).filter(|(_, n)| **n > 0).map(|(c, _)| *c).collect();
    let cell = |point: &[f64; 3]| field.lattice.nearest(&(*point).into());
    seen.points_m().iter().map(|p| cell(p).is_some_and(|cell| touched.contains(&cell))).collect()
}
