//! Prior means by cell: the stiffness expected of a cell before it is touched.
//!
//! The prior of [`crate::estimator`] is the same for all cells. If an earlier field or a camera image gives information
//! about some cells, these cells get their own prior mean m₀. Their prior variance stays that of all cells: how much
//! evidence it takes to depart from the mean depends on torque noise and prior variance, which are tuned together.
//!
//! This module only checks and sorts such a prior; [`crate::mapper`] uses its rows.

use crate::estimator::LARGEST;
use crate::lattice::{CellId, CellRows, Lattice};

/// What can be wrong with a prior by cell.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum PriorMeansError {
    /// A cell outside the lattice.
    #[error("cell {cell} of the prior is not in the lattice, which has {n_cells} cells")]
    Outside { cell: u32, n_cells: u64 },
    /// A cell that is given twice.
    #[error("cell {cell} comes twice in the prior; give each cell one expected stiffness")]
    Twice { cell: u32 },
    /// A stiffness out of range.
    #[error("the prior of cell {cell} is {found} N/m; it must be from 0 to 1e9 N/m")]
    Value { cell: u32, found: f64 },
}

/// Rows for the cells of a prior in the lattice's order, and the mean of each, N/m.
///
/// The result does not depend on the order of `prior`. Cost: O(n log n).
///
/// # Errors
///
/// If a cell is outside the lattice or comes twice, or its mean is out of range.
pub(crate) fn rows(
    lattice: &Lattice,
    prior: &[(CellId, f64)],
) -> Result<(CellRows, Vec<f64>), PriorMeansError> {
    let mut sorted = prior.to_vec();
    sorted.sort_by_key(|(cell, _)| *cell);
    if let Some([(cell, _), _]) = sorted.array_windows().find(|[a, b]| a.0 == b.0) {
        return Err(PriorMeansError::Twice { cell: cell.0 });
    }
    let mut rows = CellRows::new(lattice.clone());
    for &(cell, found) in &sorted {
        if !lattice.contains(cell) {
            return Err(PriorMeansError::Outside { cell: cell.0, n_cells: lattice.n_cells() });
        }
        if !(0.0..=LARGEST).contains(&found) {
            return Err(PriorMeansError::Value { cell: cell.0, found });
        }
        rows.row_of(cell);
    }
    Ok((rows, sorted.into_iter().map(|(_, mean)| mean).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checked(prior: &[(u32, f64)]) -> Result<(CellRows, Vec<f64>), PriorMeansError> {
        let lattice = Lattice::new([0.0; 3], 0.01, [10; 3]).unwrap();
        rows(&lattice, &prior.iter().map(|&(cell, mean)| (CellId(cell), mean)).collect::<Vec<_>>())
    }

    #[test]
    fn the_rows_of_a_prior_follow_the_lattice_whatever_order_it_came_in() {
        let (rows, means) = checked(&[(7, 0.5), (999, 0.0), (3, 2.0)]).unwrap();
        assert_eq!(rows.cells(), [CellId(3), CellId(7), CellId(999)]);
        assert_eq!(means, [2.0, 0.5, 0.0]);
    }

    #[test]
    fn an_invalid_prior_mean_is_refused_and_its_cell_named() {
        for (prior, words) in [
            (&[(3, 1.0), (7, 1.0), (3, 1.0)][..], "cell 3 comes twice"),
            (&[(1000, 1.0)], "cell 1000 of the prior is not in the lattice"),
            (&[(2, -1e-9)], "the prior of cell 2 is -0.000000001 N/m"),
            (&[(2, f64::NAN)], "the prior of cell 2 is NaN N/m"),
            (&[(2, f64::INFINITY)], "the prior of cell 2 is inf N/m"),
        ] {
            let error = checked(prior).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}
