//! The springs of a prediction, brick by brick.
//!
//! A spring represents one cell or several: a cluster of known neighbours ([`super::clusters`]), or a block of
//! untouched cells. The mapper only copies the estimates of its cells; the predictor forms clusters near the path.

use std::sync::OnceLock;

use nalgebra::Vector3;

use super::clusters::Clusters;
use crate::elastic::ElasticModel;
use crate::estimator::{CellEstimate, Estimator};
use crate::lattice::{BRICK_CELLS, BRICK_EDGE, Bricks, CellRows, Lattice, RowsOfBricks};

/// A spring that represents one or several cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spring {
    /// K, N/m: sum over its cells.
    pub(super) stiffness_n_per_m: f64,
    /// Variance of K, (N/m)²: sum over its cells.
    pub(super) variance: f64,
    /// K², (N/m)²: sum of the squares over its cells.
    pub(super) square: f64,
    /// Number of its cells.
    pub(super) stands_for: f64,
    /// Whether its cell was touched when the field was learnt.
    pub(super) is_known: bool,
    /// Its rest point relative to that of the cell where it is listed, in cells.
    pub(super) offset: Vector3<f64>,
}

/// Edge of a block of untouched cells that one spring represents in a coarse predictor, in cells.
const EDGE: u32 = 4;

/// The springs of a field at one moment.
#[derive(Debug, Clone)]
pub(crate) struct Springs {
    lattice: Lattice,
    rows: RowsOfBricks,
    /// Estimates of the cells, by row.
    known: Vec<CellEstimate>,
    /// Largest weight of a cluster, in average cells; with 1 or less, there are no clusters.
    cluster_weight: f64,
    /// The clusters, formed at the first query.
    groups: OnceLock<Clusters>,
    /// The spring of a block of untouched cells, and the edge of such a block.
    other: Spring,
    edge: u32,
}

impl From<CellEstimate> for Spring {
    fn from(cell: CellEstimate) -> Self {
        Self {
            stiffness_n_per_m: cell.stiffness_n_per_m,
            variance: cell.std_n_per_m.powi(2),
            square: cell.stiffness_n_per_m.powi(2),
            stands_for: 1.0,
            is_known: cell.count > 0,
            offset: Vector3::zeros(),
        }
    }
}

impl Spring {
    /// A spring that represents `stands_for` springs like this one.
    fn times(self, stands_for: f64) -> Self {
        Self {
            stiffness_n_per_m: self.stiffness_n_per_m * stands_for,
            variance: self.variance * stands_for,
            square: self.square * stands_for,
            stands_for,
            ..self
        }
    }
}

impl Springs {
    /// The springs of an estimator's cells as they are now, in clusters of at most `cluster_weight`.
    ///
    /// Cost: a copy, 3 to 5 ns a cell.
    pub(crate) fn new(rows: &CellRows, estimator: &dyn Estimator, cluster_weight: f64) -> Self {
        let (known, other) = (estimator.estimates(rows.len()), estimator.estimate(usize::MAX));
        Self::of(rows, known, other, cluster_weight)
    }

    /// The springs of cells with these estimates, by row, and with the estimate `other` for all other cells.
    pub(super) fn of(
        rows: &CellRows,
        known: Vec<CellEstimate>,
        other: CellEstimate,
        cluster_weight: f64,
    ) -> Self {
        let edge = if cluster_weight > 1.0 { EDGE } else { 1 };
        let other = Spring::from(other).times(f64::from(edge.pow(3)));
        let (lattice, rows) = (rows.lattice().clone(), rows.by_brick().clone());
        Self { lattice, rows, known, cluster_weight, groups: OnceLock::new(), other, edge }
    }

    /// Sets the stiffness of every spring to that beside an elastic body. Cells that were touched only in the
    /// downsampled touches from which the body was learnt have no row here, and stay untouched cells.
    pub(super) fn set_beside_body(&mut self, model: &ElasticModel) {
        let of_untouched = model.untouched_residual_n_per_m;
        let mut residual = vec![of_untouched; self.known.len()];
        for (cell, k) in model.residual() {
            let (brick, inside) = Bricks::<()>::locate(self.lattice.place(cell));
            let row = self.rows.get(brick).map(|rows| rows[inside] as usize);
            if let Some(place) = row.and_then(|row| residual.get_mut(row)) {
                *place = k;
            }
        }
        for (cell, residual) in self.known.iter_mut().zip(residual) {
            cell.stiffness_n_per_m = model.spring_n_per_m(cell.stiffness_n_per_m, residual);
        }
        let cells = f64::from(self.edge.pow(3));
        let other = model.spring_n_per_m(self.other.stiffness_n_per_m / cells, of_untouched);
        self.other.stiffness_n_per_m = cells * other;
        self.other.square = cells * other * other;
        self.groups = OnceLock::new();
    }

    pub(super) fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// Whether springs represent clusters.
    pub(super) fn are_clusters(&self) -> bool {
        self.edge > 1
    }

    /// The clusters of the known cells, if there are any.
    fn groups(&self) -> Option<&Clusters> {
        let groups = || Clusters::new(&self.known, self.cluster_weight);
        self.are_clusters().then(|| self.groups.get_or_init(groups))
    }

    /// The springs of the brick whose first place is `low`, each with its place in the lattice.
    pub(super) fn of_brick(&self, low: [u32; 3]) -> Vec<([u32; 3], Spring)> {
        let rows = self.rows.get(low.map(|n| n / BRICK_EDGE));
        let known = |inside: usize| {
            let row = rows?[inside];
            self.known.get(row as usize).map(|cell| Spring::from(*cell))
        };
        let mut springs = Vec::new();
        if rows.is_some() {
            let mut list = |(inside, spring)| springs.push((place(low, inside), spring));
            match self.groups() {
                Some(groups) => groups.leaders(known, list),
                None => (0..BRICK_CELLS).for_each(|inside| {
                    known(inside).into_iter().for_each(|spring| list((inside, spring)));
                }),
            }
        }
        let others = representatives(low, self.edge).filter(|place| {
            let (_, inside) = Bricks::<()>::locate(*place);
            known(inside).is_none() && self.lattice.holds(*place) // bricks may reach beyond it
        });
        springs.extend(others.map(|place| (place, self.other)));
        springs
    }
}

/// The place in the lattice of a cell, given by its number inside a brick.
fn place(low: [u32; 3], inside: usize) -> [u32; 3] {
    let (inside, n) = (inside as u32, BRICK_EDGE);
    [low[0] + inside % n, low[1] + inside / n % n, low[2] + inside / (n * n)]
}

/// The cells that represent the blocks of the brick whose first place is `low`.
fn representatives(low: [u32; 3], edge: u32) -> impl Iterator<Item = [u32; 3]> {
    let n = BRICK_EDGE / edge;
    (0..n.pow(3)).map(move |block| {
        let block = [block % n, block / n % n, block / (n * n)];
        representative([0, 1, 2].map(|axis| low[axis] / edge + block[axis]), edge)
    })
}

/// The cell that represents a block.
///
/// Its place inside the block differs from block to block, so that a flat face of a link, which mostly is parallel to
/// an axis, covers about the same number of such cells wherever it is.
fn representative([i, j, k]: [u32; 3], edge: u32) -> [u32; 3] {
    let [a, b, c] = [i, j, k].map(|n| n % edge);
    let inside = [b + 2 * c, c + 2 * a, a + 2 * b];
    std::array::from_fn(|axis| edge * [i, j, k][axis] + inside[axis] % edge)
}

#[cfg(test)]
mod tests {
    use super::*;

    const OTHER: CellEstimate = CellEstimate { stiffness_n_per_m: 2.0, std_n_per_m: 3.0, count: 0 };
    const KNOWN: CellEstimate = CellEstimate { stiffness_n_per_m: 7.0, std_n_per_m: 1.0, count: 5 };

    /// Springs of a lattice in which the cells at these places are known; with `few`, in clusters.
    fn springs(known: &[[u32; 3]], few: bool) -> Springs {
        let mut rows = CellRows::new(Lattice::new([0.0; 3], 0.01, [24, 24, 20]).unwrap());
        for place in known {
            rows.row_of(rows.lattice().cell(*place));
        }
        Springs::of(&rows, vec![KNOWN; known.len()], OTHER, if few { 1e9 } else { 1.0 })
    }

    #[test]
    fn an_unknown_brick_has_one_spring_per_block_or_per_cell() {
        for (few, blocks) in [(true, 8), (false, BRICK_CELLS)] {
            let springs = springs(&[], few);
            for low in [[0, 0, 0], [8, 16, 0]] {
                let edge = if few { EDGE } else { 1 };
                let found = springs.of_brick(low);
                let mut places: Vec<_> =
                    found.iter().map(|(place, _)| place.map(|n| n / edge)).collect();
                assert!(
                    places.iter().all(|block| (0..3).all(|n| block[n] * edge / 8 == low[n] / 8))
                );
                places.sort_unstable();
                places.dedup();
                assert_eq!(places.len(), blocks, "{low:?}");
                let sum = |of: fn(&Spring) -> f64| -> f64 {
                    found.iter().map(|(_, spring)| of(spring)).sum()
                };
                let all = BRICK_CELLS as f64;
                assert_eq!(sum(|spring| spring.stands_for), all);
                assert_eq!(sum(|spring| spring.stiffness_n_per_m), 2.0 * all);
                assert_eq!(sum(|spring| spring.variance), 9.0 * all);
                assert_eq!(sum(|spring| spring.square), 4.0 * all);
            }
            // Half of the last brick is beyond the lattice.
            let last = springs.of_brick([16, 16, 16]);
            assert_eq!(last.iter().map(|(_, spring)| spring.stands_for).sum::<f64>(), 256.0);
        }
    }

    #[test]
    fn every_known_cell_is_a_spring_or_belongs_to_one() {
        for few in [true, false] {
            let others = springs(&[], few).of_brick([8, 16, 8]);
            let places = [others[0].0, others[1].0, [9, 20, 15]];
            let springs = springs(&places, few);
            let found = springs.of_brick([8, 16, 8]);
            let (known, unknown): (Vec<_>, Vec<_>) =
                found.into_iter().partition(|(_, spring)| spring.is_known);
            assert_eq!(known.iter().map(|(_, spring)| spring.stands_for).sum::<f64>(), 3.0);
            assert_eq!(known.iter().map(|(_, spring)| spring.stiffness_n_per_m).sum::<f64>(), 21.0);
            assert!(known.iter().all(|(place, _)| places.contains(place)));
            let left = others.iter().filter(|(place, _)| !places.contains(place));
            assert!(unknown.iter().eq(left));
            assert!(springs.of_brick([8, 16, 0]).iter().all(|(_, spring)| !spring.is_known));
        }
    }

    #[test]
    fn later_cells_do_not_change_the_springs() {
        let mut rows = CellRows::new(Lattice::new([0.0; 3], 0.01, [24, 24, 20]).unwrap());
        rows.row_of(rows.lattice().cell([1, 2, 3]));
        let springs = Springs::of(&rows, vec![KNOWN], OTHER, 1.0);
        let before = springs.of_brick([0, 0, 0]);
        rows.row_of(rows.lattice().cell([4, 5, 6]));
        assert_eq!(springs.of_brick([0, 0, 0]), before);
    }
}
