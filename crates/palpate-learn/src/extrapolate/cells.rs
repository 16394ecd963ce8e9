//! The stiffness of touched cells, as evidence about a stiffness over features.
//!
//! A cell that a single touch brushed says less than one that was pressed again and again: n frames
//! count as much as `n/(n + 20)` of a cell that is known.

use std::collections::{HashMap, HashSet};

use palpate::{CellId, Field};

use super::cloud::SeenCloud;
use super::process::{Evidence, Process};

/// Frames that make a cell half known.
const HALF_KNOWN: f64 = 20.0;

/// How much a cell counts that so many frames touched.
fn weight(frames: u32) -> f64 {
    f64::from(frames) / (f64::from(frames) + HALF_KNOWN)
}

/// The evidence of touched cells, given by their rows in the field, that lie at seen points.
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

/// Of every seen point the mean stiffness of the touched cells to which it is the nearest, N/m, and
/// their weight; else that of the touched cell in which it lies; `None` without such a cell.
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
