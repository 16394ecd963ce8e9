//! Writes extrapolated stiffness into a field, as the expected stiffness of untouched cells.

use std::collections::HashMap;
use std::sync::Arc;

use palpate::{CellId, EstimatorKind};
use palpate_io::field::SavedField;

/// Adds untouched cells to a field, each with its expected stiffness, N/m.
///
/// Touched cells keep their learnt stiffness. The snapshot gets the new cells, too, so that a mapper that continues has
/// the same prior means.
pub fn filled(mut saved: SavedField, expected: &[(CellId, f64)]) -> SavedField {
    if expected.is_empty() {
        return saved;
    }
    let SavedField { field, snapshot, prior_n_per_m, .. } = &mut saved;
    // Bands were calibrated on other predictions.
    field.calibration = None;
    field.elastic.iter_mut().for_each(|model| Arc::make_mut(model).calibration = None);
    snapshot.iter_mut().for_each(|snapshot| snapshot.calibration = None);
    // The least stiffness with which the estimator can begin, and the standard deviation of an untouched cell, N/m.
    let (least, std) = match snapshot {
        Some(snapshot) => {
            let config = &snapshot.config;
            let (mean, std) = config.estimator.prior.at_spacing(config.lattice.spacing_m());
            // At κ = 0 the paper's filter would never learn.
            (if config.method == EstimatorKind::Ekf { mean } else { 0.0 }, std)
        }
        // Without a snapshot the prior is not known: the largest standard deviation of the field is used.
        None => (0.0, field.std_n_per_m.iter().copied().fold(0.0, f64::max)),
    };
    // Earlier prior means are kept for cells that this cloud does not show.
    let mut prior = prior_n_per_m.take().unwrap_or_default();
    prior.resize(field.cells.len(), field.untouched_n_per_m);
    let rows: HashMap<CellId, usize> =
        field.cells.iter().enumerate().map(|(row, cell)| (*cell, row)).collect();
    for &(cell, k) in expected {
        let k = k.max(least);
        if let Some(&row) = rows.get(&cell) {
            prior[row] = k;
            // Untouched cells of an earlier extrapolation get the new stiffness.
            if field.counts[row] == 0 {
                field.stiffness_n_per_m[row] = k;
                if let Some(snapshot) = snapshot {
                    snapshot.state.mean[row] = k;
                }
            }
            continue;
        }
        prior.push(k);
        field.cells.push(cell);
        field.stiffness_n_per_m.push(k);
        field.std_n_per_m.push(std);
        field.counts.push(0);
        if let Some(snapshot) = snapshot {
            let state = &mut snapshot.state;
            snapshot.cells.push(cell);
            state.mean.push(k);
            state.variance.push(std * std);
            state.counts.push(0);
            if snapshot.config.method == EstimatorKind::Ekf {
                state.seen.push(0);
            }
        }
    }
    if let Some(snapshot) = snapshot {
        snapshot.prior_means_n_per_m.clone_from(&prior);
    }
    *prior_n_per_m = Some(prior);
    saved
}
