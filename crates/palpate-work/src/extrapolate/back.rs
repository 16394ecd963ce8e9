//! Extrapolated stiffness back into a field: what cells that no touch has reached are expected to be.

use std::collections::HashMap;

use palpate::{CellId, EstimatorKind, MapperConfig};
use palpate_io::field::Saved;

/// Adds cells that were not touched, each with its expected stiffness, N/m.
///
/// Touched cells keep what they have learnt. The memory goes on from there as well: a mapper that
/// continues believes the same of the new cells.
pub fn filled(mut saved: Saved, expected: &[(CellId, f64)]) -> Saved {
    let least = saved.snapshot.as_ref().map_or(0.0, |snapshot| least(&snapshot.config));
    let expected: Vec<(CellId, f64)> =
        expected.iter().map(|&(cell, k)| (cell, k.max(least))).collect();
    let field = &mut saved.field;
    let by_cell: HashMap<CellId, f64> = expected.iter().copied().collect();
    let known: HashMap<CellId, usize> =
        field.cells.iter().enumerate().map(|(row, cell)| (*cell, row)).collect();
    // What an earlier prior expected of cells that this cloud does not show still holds.
    let earlier = saved.prior_n_per_m.take().unwrap_or_default();
    let of = |(row, cell): (usize, &CellId)| {
        let earlier = earlier.get(row).copied().unwrap_or(field.untouched_n_per_m);
        by_cell.get(cell).copied().unwrap_or(earlier)
    };
    let mut prior: Vec<f64> = field.cells.iter().enumerate().map(of).collect();
    // Of cells that an earlier extrapolation added, the new one knows better.
    let fresh = |row: &usize| field.counts[*row] == 0;
    let renewed: Vec<(usize, f64)> = (known.iter().filter(|(_, row)| fresh(row)))
        .filter_map(|(cell, row)| Some((*row, *by_cell.get(cell)?)))
        .collect();
    let added: Vec<(CellId, f64)> =
        expected.iter().filter(|(cell, _)| !known.contains_key(cell)).copied().collect();
    // Without a memory the settings are not known: the least known cell is as little known.
    let least_known = field.std_n_per_m.iter().copied().fold(0.0, f64::max);
    let prior_std = saved.snapshot.as_ref().map_or(least_known, |snapshot| std(&snapshot.config));
    for &(row, k) in &renewed {
        field.stiffness_n_per_m[row] = k;
    }
    for &(cell, k) in &added {
        field.cells.push(cell);
        field.stiffness_n_per_m.push(k);
        field.std_n_per_m.push(prior_std);
        field.counts.push(0);
        prior.push(k);
    }
    if let Some(snapshot) = &mut saved.snapshot {
        let (config, state) = (&snapshot.config, &mut snapshot.state);
        for (row, k) in renewed {
            state.mean[row] = k;
        }
        for (cell, k) in added {
            snapshot.cells.push(cell);
            state.mean.push(k);
            state.variance.push(prior_std * prior_std);
            state.counts.push(0);
            if config.method == EstimatorKind::Ekf {
                state.seen.push(0);
            }
        }
        snapshot.prior_means_n_per_m.clone_from(&prior);
    }
    saved.prior_n_per_m = Some(prior);
    saved
}

/// Standard deviation of a cell that was never touched, N/m.
fn std(config: &MapperConfig) -> f64 {
    config.estimator.prior.at_spacing(config.lattice.spacing_m()).1
}

/// The least stiffness that an estimator can begin with, N/m: at κ = 0 the paper's filter would never
/// learn.
fn least(config: &MapperConfig) -> f64 {
    match config.method {
        EstimatorKind::Ekf => config.estimator.prior.at_spacing(config.lattice.spacing_m()).0,
        EstimatorKind::Map => 0.0,
    }
}
