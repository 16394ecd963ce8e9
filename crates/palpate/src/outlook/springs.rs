//! The springs that an answer adds up, brick by brick.
//!
//! A spring is a cell, or stands for several: for neighbours that the field knows
//! ([`super::groups`]), or for those of a block of which it knows nothing, of which one is
//! followed.

use std::ops::Range;

use crate::field::CellEstimate;
use crate::lattice::{BRICK_EDGE, BrickBits, Bricks, CellRows, Lattice};

/// A spring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spring {
    /// K, N/m; the sum over the cells that it stands for.
    pub(super) stiffness_n_per_m: f64,
    /// Its variance, (N/m)²; the sum likewise.
    pub(super) variance: f64,
    /// Cells that it stands for.
    pub(super) stands_for: f64,
    /// Whether its cell was touched when the field was learnt.
    pub(super) is_known: bool,
}

/// Edge of a block in which one cell stands for all of which the field knows nothing, where few
/// springs are followed.
const EDGE: u32 = 4;

/// The springs of a field, of which those that it knows are listed.
#[derive(Debug, Clone)]
pub(super) struct Springs {
    lattice: Lattice,
    bricks: Bricks<Listed>,
    /// Place in its brick, and spring.
    listed: Vec<(usize, Spring)>,
    /// What stands for cells that are not listed, and edge of the blocks for each of which it does.
    other: Spring,
    edge: u32,
}

/// What is listed of a brick.
#[derive(Debug, Clone)]
struct Listed {
    /// Cells that springs of the list stand for.
    cells: BrickBits,
    springs: Range<usize>,
}

impl From<CellEstimate> for Spring {
    fn from(cell: CellEstimate) -> Self {
        Self {
            stiffness_n_per_m: cell.stiffness_n_per_m,
            variance: cell.std_n_per_m.powi(2),
            stands_for: 1.0,
            is_known: cell.count > 0,
        }
    }
}

impl Spring {
    /// A spring that stands for so many like this one.
    fn times(self, stands_for: f64) -> Self {
        Self {
            stiffness_n_per_m: self.stiffness_n_per_m * stands_for,
            variance: self.variance * stands_for,
            stands_for,
            ..self
        }
    }
}

impl Springs {
    /// A list without entries. All cells are like `other`; if `few` are to be followed, one in
    /// every block of 4³ stands for it.
    pub(super) fn new(lattice: Lattice, other: Spring, few: bool) -> Self {
        let edge = if few { EDGE } else { 1 };
        let other = other.times(f64::from(edge.pow(3)));
        Self { lattice, bricks: Bricks::default(), listed: Vec::new(), other, edge }
    }

    /// One spring for each cell of a field; `estimate` knows them by row, and of any other number
    /// what is said of cells without one.
    pub(super) fn all(rows: &CellRows, estimate: impl Fn(usize) -> CellEstimate) -> Self {
        let mut springs = Self::new(rows.lattice().clone(), estimate(usize::MAX).into(), false);
        for (brick, rows_inside) in rows.bricks() {
            let row = |inside: usize| rows_inside[inside] as usize;
            let known = (0..rows_inside.len()).filter(|&inside| row(inside) < rows.len());
            let mut cells = BrickBits::default();
            known.clone().for_each(|inside| cells.insert(inside));
            let known = known.map(|inside| (inside, estimate(row(inside)).into()));
            springs.list(brick, cells, known);
        }
        springs
    }

    /// Lists springs that stand for cells of a brick, counted in bricks, each with its place there.
    pub(super) fn list(
        &mut self,
        brick: [u32; 3],
        cells: BrickBits,
        springs: impl Iterator<Item = (usize, Spring)>,
    ) {
        let first = self.listed.len();
        self.listed.extend(springs);
        let springs = first..self.listed.len();
        self.bricks.get_or_insert_with(brick, || Listed { cells, springs });
    }

    /// Whether few springs stand for many.
    pub(super) fn are_few(&self) -> bool {
        self.edge > 1
    }

    /// The springs of a brick, by its first place, each with its place in the lattice.
    pub(super) fn of_brick(&self, low: [u32; 3]) -> impl Iterator<Item = ([u32; 3], Spring)> {
        let brick = self.bricks.get(low.map(|n| n / BRICK_EDGE));
        let (cells, springs) = match brick {
            Some(Listed { cells, springs }) => (*cells, springs.clone()),
            None => (BrickBits::default(), 0..0),
        };
        let listed = self.listed[springs].iter();
        let listed = listed.map(move |&(inside, spring)| (place(low, inside), spring));
        let others = representatives(low, self.edge).filter(move |place| {
            let (_, inside) = Bricks::<()>::locate(*place);
            !cells.get(inside) && self.lattice.holds(*place) // bricks may reach beyond it
        });
        listed.chain(others.map(|place| (place, self.other)))
    }
}

/// The place in the lattice of a place in a brick.
fn place(low: [u32; 3], inside: usize) -> [u32; 3] {
    let (inside, n) = (inside as u32, BRICK_EDGE);
    [low[0] + inside % n, low[1] + inside / n % n, low[2] + inside / (n * n)]
}

/// The cells that stand for the blocks of a brick, by its first place.
fn representatives(low: [u32; 3], edge: u32) -> impl Iterator<Item = [u32; 3]> {
    let n = BRICK_EDGE / edge;
    (0..n.pow(3)).map(move |block| {
        let block = [block % n, block / n % n, block / (n * n)];
        representative([0, 1, 2].map(|axis| low[axis] / edge + block[axis]), edge)
    })
}

/// The cell that stands for those of its block.
///
/// It lies elsewhere in every block, so that a flat face of a link, which mostly lies along an
/// axis, meets as many of them wherever it is.
fn representative([i, j, k]: [u32; 3], edge: u32) -> [u32; 3] {
    let [a, b, c] = [i, j, k].map(|n| n % edge);
    let inside = [b + 2 * c, c + 2 * a, a + 2 * b];
    std::array::from_fn(|axis| edge * [i, j, k][axis] + inside[axis] % edge)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::BRICK_CELLS;

    const OTHER: Spring =
        Spring { stiffness_n_per_m: 2.0, variance: 3.0, stands_for: 1.0, is_known: false };
    const KNOWN: Spring =
        Spring { stiffness_n_per_m: 7.0, variance: 1.0, stands_for: 5.0, is_known: true };

    fn lattice() -> Lattice {
        Lattice::new([0.0; 3], 0.01, [24, 24, 20]).unwrap()
    }

    #[test]
    fn of_what_is_not_listed_every_block_has_one_or_every_cell_is_its_own() {
        for (few, blocks) in [(true, 8), (false, BRICK_CELLS)] {
            let springs = Springs::new(lattice(), OTHER, few);
            for low in [[0, 0, 0], [8, 16, 0]] {
                let edge = if few { EDGE } else { 1 };
                let mut found: Vec<_> =
                    springs.of_brick(low).map(|(place, _)| place.map(|n| n / edge)).collect();
                assert!(
                    found.iter().all(|block| (0..3).all(|n| block[n] * edge / 8 == low[n] / 8))
                );
                found.sort_unstable();
                found.dedup();
                assert_eq!(found.len(), blocks, "{low:?}");
                let cells: f64 = springs.of_brick(low).map(|(_, spring)| spring.stands_for).sum();
                assert_eq!(cells, BRICK_CELLS as f64);
                let stiffness: f64 =
                    springs.of_brick(low).map(|(_, spring)| spring.stiffness_n_per_m).sum();
                assert_eq!(stiffness, 2.0 * BRICK_CELLS as f64);
            }
            // Half of the last brick is beyond the lattice.
            let last = springs.of_brick([16, 16, 16]);
            assert_eq!(last.map(|(_, spring)| spring.stands_for).sum::<f64>(), 256.0);
        }
    }

    #[test]
    fn a_cell_that_is_listed_stands_for_itself_or_is_stood_for() {
        let mut springs = Springs::new(lattice(), OTHER, true);
        let others: Vec<_> = springs.of_brick([8, 16, 8]).collect();
        let bits = |places: &[[u32; 3]]| {
            let mut bits = BrickBits::default();
            places.iter().for_each(|place| bits.insert(Bricks::<()>::locate(*place).1));
            bits
        };
        let (_, inside) = Bricks::<()>::locate([9, 20, 15]);
        let cells = bits(&[others[0].0, others[1].0]);
        springs.list([1, 2, 1], cells, [(inside, KNOWN)].into_iter());
        let found: Vec<_> = springs.of_brick([8, 16, 8]).collect();
        assert_eq!(found[0], ([9, 20, 15], KNOWN));
        assert_eq!(found[1..], others[2..]);
        assert_eq!(springs.of_brick([8, 16, 0]).count(), 8);
    }
}
