//! Rows: numbers of cells without gaps, in the order of first touch, after cells with their own prior mean.

use std::sync::Arc;

use super::{BRICK_CELLS, Bricks, CellId, Lattice};

/// Cells numbered in the order in which they are first used, with their rest points.
///
/// Arrays indexed by *row* hold the touched cells without gaps, and cells that are touched together are close to each
/// other in memory.
#[derive(Debug, Clone)]
pub struct CellRows {
    lattice: Lattice,
    rows: RowsOfBricks,
    cells: Vec<CellId>,
    points_m: Vec<[f64; 3]>,
}

/// Rows of cells, by brick and by number inside the brick; [`NO_ROW`] for cells without a row.
///
/// A copy shares its bricks with the original until the original adds a cell to one of them.
pub(crate) type RowsOfBricks = Bricks<Arc<[u32; BRICK_CELLS]>>;

/// Marks a cell without a row.
const NO_ROW: u32 = u32::MAX;

impl CellRows {
    /// A numbering without rows.
    pub fn new(lattice: Lattice) -> Self {
        Self { lattice, rows: Bricks::default(), cells: Vec::new(), points_m: Vec::new() }
    }

    /// Rows for these cells, in this order.
    ///
    /// # Panics
    ///
    /// As [`CellRows::row_of`].
    pub fn of(lattice: Lattice, cells: &[CellId]) -> Self {
        let mut rows = Self::new(lattice);
        for &cell in cells {
            rows.row_of(cell);
        }
        rows
    }

    /// The lattice that the cells belong to.
    pub fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// The row of a cell; a cell without a row gets the next one.
    ///
    /// # Panics
    ///
    /// If the cell is not one of the lattice's, which is a bug in the caller.
    pub fn row_of(&mut self, cell: CellId) -> u32 {
        assert!(self.lattice.contains(cell), "{cell:?} is not in the lattice");
        let place = self.lattice.place(cell);
        let (brick, inside) = Bricks::<()>::locate(place);
        let brick = self.rows.get_or_insert_with(brick, || Arc::new([NO_ROW; BRICK_CELLS]));
        if brick[inside] == NO_ROW {
            Arc::make_mut(brick)[inside] = self.cells.len() as u32;
            self.cells.push(cell);
            self.points_m.push(self.lattice.point_at(place).into());
        }
        brick[inside]
    }

    /// The row of a cell, if it has one.
    pub fn find(&self, cell: CellId) -> Option<u32> {
        let (brick, inside) = Bricks::<()>::locate(self.lattice.place(cell));
        self.rows.get(brick).map(|rows| rows[inside]).filter(|&row| row != NO_ROW)
    }

    /// Values by row, from values by cell; cells without a row get one, and rows without a value get `default`.
    pub(crate) fn by_row(
        &mut self,
        given: impl Iterator<Item = (CellId, f64)>,
        default: f64,
    ) -> Vec<f64> {
        let mut by_row = vec![default; self.len()];
        for (cell, number) in given {
            let row = self.row_of(cell) as usize;
            by_row.resize(self.len(), default);
            by_row[row] = number;
        }
        by_row
    }

    /// The cells, by row.
    pub fn cells(&self) -> &[CellId] {
        &self.cells
    }

    /// Rest points of the cells by row, world frame, m.
    pub fn points_m(&self) -> &[[f64; 3]] {
        &self.points_m
    }

    /// The rows, by brick.
    pub(crate) fn by_brick(&self) -> &RowsOfBricks {
        &self.rows
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.cells.len()
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.cells.is_empty()
    }
}

/// Finds the rows of *runs*: lists of cells, one for each link, that change little from step to step.
///
/// From one step to the next, some cells leave a run, and new ones are added at its end. The rows of the other cells
/// are found by walking along the previous run, with one comparison each instead of a look-up.
#[derive(Debug, Clone, Default)]
pub(crate) struct RowCache {
    runs: Vec<Run>,
}

#[derive(Debug, Clone, Default)]
struct Run {
    cells: Vec<CellId>,
    rows: Vec<u32>,
    /// The previous rows; their memory is reused.
    last_rows: Vec<u32>,
}

impl RowCache {
    /// The rows of the cells of run number `run`; a cell without a row gets the next one.
    ///
    /// # Panics
    ///
    /// If a cell is not one of the lattice's, which is a bug in the caller.
    pub(crate) fn follow(&mut self, run: usize, cells: &[CellId], rows: &mut CellRows) -> &[u32] {
        if self.runs.len() <= run {
            self.runs.resize(run + 1, Run::default());
        }
        let run = &mut self.runs[run];
        std::mem::swap(&mut run.rows, &mut run.last_rows);
        let mut stayed = run.cells.iter().zip(&run.last_rows);
        run.rows.clear();
        run.rows.extend(cells.iter().map(|&cell| {
            let known = stayed.find(|(old, _)| **old == cell).map(|(_, &row)| row);
            known.unwrap_or_else(|| rows.row_of(cell))
        }));
        run.cells.clear();
        run.cells.extend_from_slice(cells);
        &run.rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_follow_the_order_of_touch_and_memory_the_bricks() {
        let mut rows = CellRows::new(Lattice::new([0.0; 3], 0.01, [1000; 3]).unwrap());
        let far = rows.lattice().cell([999, 999, 999]);
        let near = rows.lattice().cell([0, 0, 0]);
        assert_eq!((rows.row_of(far), rows.row_of(near), rows.row_of(far)), (0, 1, 0));
        assert_eq!((rows.find(near), rows.find(CellId(1))), (Some(1), None));
        assert_eq!(rows.len(), 2);
        assert!((rows.points_m()[0][0] - 9.99).abs() < 1e-6);
    }

    #[test]
    fn the_cached_rows_of_a_run_equal_those_of_its_cells() {
        let mut rows = CellRows::new(Lattice::new([0.0; 3], 0.01, [100; 3]).unwrap());
        let mut runs = RowCache::default();
        let cells = |numbers: &[u32]| numbers.iter().map(|&n| CellId(n)).collect::<Vec<_>>();
        for numbers in [&[5, 6, 7, 8][..], &[5, 7, 8, 9], &[9, 5, 40], &[], &[7, 40]] {
            let found = runs.follow(1, &cells(numbers), &mut rows).to_vec();
            let expected: Vec<u32> = cells(numbers).iter().map(|&c| rows.row_of(c)).collect();
            assert_eq!(found, expected);
        }
        assert_eq!(rows.len(), 6);
    }
}
