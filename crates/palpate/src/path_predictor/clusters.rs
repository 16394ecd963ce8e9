//! Clusters of neighbouring springs, each replaced by one spring in a coarse predictor.
//!
//! Displacements of neighbours differ little. So a single spring with the sum of their stiffness, at their
//! stiffness-weighted centre, exerts nearly the same force. Clusters are blocks of 4³ cells, halved repeatedly, down to
//! single cells, as long as their *weight* exceeds a limit: so no spring contributes much more to a prediction than the
//! others. The weight of a cell is the mean of its stiffness and its variance, each relative to the mean over all
//! cells.

use std::sync::LazyLock;

use nalgebra::Vector3;

use super::springs::Spring;
use crate::estimator::CellEstimate;
use crate::lattice::{BRICK_CELLS, Bricks};

/// Largest weight of a cluster, in average cells, for fast predictions; see [`crate::Mapper::coarse_path_predictor`].
pub const CLUSTER_WEIGHT: f64 = 24.0;

/// The largest block has 2^`LARGEST` cells.
const LARGEST: u32 = 6;

/// A known cell of a brick.
#[derive(Debug, Clone, Copy)]
struct Known {
    /// Its number in the brick in block order (see [`place`]).
    number: usize,
    spring: Spring,
    /// Weight of this cell and of all before it in the brick.
    weight_up_to: f64,
}

/// How the cells of a field are grouped.
#[derive(Debug, Clone)]
pub(super) struct Clusters {
    /// Largest weight of a group.
    most: f64,
    /// Inverse means of stiffness, 1/(N/m), and of variance, 1/(N/m)², over all cells.
    per_stiffness: f64,
    per_variance: f64,
}

/// For the cells of a brick in block order, their numbers inside the brick as in [`Bricks`].
static INSIDE: LazyLock<[usize; BRICK_CELLS]> = LazyLock::new(|| std::array::from_fn(inside));

/// For the cells of a brick in block order, their places in the brick.
static PLACES: LazyLock<[Vector3<f64>; BRICK_CELLS]> =
    LazyLock::new(|| std::array::from_fn(|n| place(n).map(|n| n as f64).into()));

impl Clusters {
    /// Clusters with a weight of at most `most` average cells, except for single cells.
    pub(super) fn new(cells: &[CellEstimate], most: f64) -> Self {
        let (mut stiffness, mut variance) = (0.0, 0.0);
        for cell in cells {
            stiffness += cell.stiffness_n_per_m;
            variance += cell.std_n_per_m.powi(2);
        }
        let per = |sum: f64| if sum > 0.0 { cells.len() as f64 / sum } else { 0.0 };
        Self { most, per_stiffness: per(stiffness), per_variance: per(variance) }
    }

    /// Calls `list` for each group of the cells of a brick, with the spring that represents it and the number of its
    /// cell inside the brick; `known` gives the spring of a known cell by that number.
    ///
    /// Cost: some 30 ns a cell.
    pub(super) fn leaders(
        &self,
        known: impl Fn(usize) -> Option<Spring>,
        mut list: impl FnMut((usize, Spring)),
    ) {
        let (mut cells, mut weight_up_to) = (Vec::with_capacity(BRICK_CELLS), 0.0);
        for (number, &inside) in INSIDE.iter().enumerate() {
            let Some(spring) = known(inside) else { continue };
            let by_stiffness = spring.stiffness_n_per_m * self.per_stiffness;
            weight_up_to += (by_stiffness + spring.variance * self.per_variance) / 2.0;
            cells.push(Known { number, spring, weight_up_to });
        }
        divide(&cells, self.most, &mut |group| {
            let (number, spring) = leader(group);
            list((INSIDE[number], spring));
        });
    }
}

/// Number inside the brick, as in [`Bricks`], of the n-th cell in block order.
fn inside(n: usize) -> usize {
    let (_, inside) = Bricks::<()>::locate(place(n).map(|n| n as u32));
    inside
}

/// Place in the brick of the n-th cell in *block order*: the bits of n are those of x, y and z in turn, so that the
/// cells of a block have consecutive numbers.
fn place(n: usize) -> [usize; 3] {
    std::array::from_fn(|axis| (0..3).map(|bit| (n >> (3 * bit + axis) & 1) << bit).sum())
}

/// Calls `group` with every group among the cells of a brick, which are sorted by number.
fn divide(cells: &[Known], most: f64, group: &mut impl FnMut(&[Known])) {
    let mut before = 0.0;
    for block in cells.chunk_by(|a, b| a.number >> LARGEST == b.number >> LARGEST) {
        before = halve(block, before, LARGEST, most, group);
    }
}

/// Calls `group` with every group of a block of 2^`size` cells. `before` is the weight of all cells of the brick before
/// the block; returns the weight including the block.
fn halve(
    cells: &[Known],
    before: f64,
    size: u32,
    most: f64,
    group: &mut impl FnMut(&[Known]),
) -> f64 {
    let Some(last) = cells.last() else { return before };
    if cells.len() > 1 && last.weight_up_to - before > most {
        let size = size - 1;
        let half = cells.partition_point(|cell| cell.number >> size & 1 == 0);
        let middle = halve(&cells[..half], before, size, most, group);
        halve(&cells[half..], middle, size, most, group);
    } else {
        group(cells);
    }
    last.weight_up_to
}

/// The spring that represents a group, at its stiffness-weighted centre, and the number of the nearest cell.
fn leader(group: &[Known]) -> (usize, Spring) {
    if let [single] = group {
        return (single.number, single.spring);
    }
    let (mut middle, mut sum) = (Vector3::zeros(), 0.0);
    let (mut stiffness_n_per_m, mut variance, mut square) = (0.0, 0.0, 0.0);
    for Known { number, spring, .. } in group {
        let weight = spring.stiffness_n_per_m + f64::MIN_POSITIVE; // all may be 0
        middle += PLACES[*number] * weight;
        sum += weight;
        stiffness_n_per_m += spring.stiffness_n_per_m;
        variance += spring.variance;
        square += spring.square;
    }
    middle /= sum;
    let away = |cell: &Known| (PLACES[cell.number] - middle).norm_squared();
    let nearest = group.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
    let &Known { number, spring, .. } = nearest.expect("a group is never empty");
    let (stands_for, offset) = (group.len() as f64, middle - PLACES[number]);
    (number, Spring { stiffness_n_per_m, variance, square, stands_for, offset, ..spring })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::{BRICK_EDGE, CellId, CellRows, Lattice};
    use crate::path_predictor::Springs;

    /// Rows of all cells of two bricks of a lattice.
    fn rows() -> CellRows {
        let lattice = Lattice::new([0.0; 3], 0.01, [2 * BRICK_EDGE, BRICK_EDGE, BRICK_EDGE]);
        let mut rows = CellRows::new(lattice.unwrap());
        for number in 0..2 * BRICK_CELLS as u32 {
            rows.row_of(CellId(number));
        }
        rows
    }

    /// The springs, each with its place, that represent cells with this stiffness and variance.
    fn few(
        stiffness_n_per_m: impl Fn([u32; 3]) -> f64,
        variance: impl Fn([u32; 3]) -> f64,
        most: f64,
    ) -> Vec<([u32; 3], Spring)> {
        let rows = rows();
        let estimate = |place: [u32; 3]| {
            let (stiffness_n_per_m, std_n_per_m) =
                (stiffness_n_per_m(place), variance(place).sqrt());
            CellEstimate { stiffness_n_per_m, std_n_per_m, count: place[0] }
        };
        let known = rows.cells().iter().map(|cell| estimate(rows.lattice().place(*cell)));
        let springs = Springs::of(&rows, known.collect(), estimate([0; 3]), most);
        [[0, 0, 0], [BRICK_EDGE, 0, 0]].iter().flat_map(|low| springs.of_brick(*low)).collect()
    }

    #[test]
    fn clusters_hold_every_cell_once_and_keep_sums() {
        let stiffness = |[i, j, k]: [u32; 3]| f64::from(i * 7 % 5 + j * k);
        let variance = |[i, j, k]: [u32; 3]| f64::from((i + 3 * j + 5 * k) % 11);
        let places: Vec<_> =
            rows().cells().iter().map(|cell| rows().lattice().place(*cell)).collect();
        let all = |of: &dyn Fn([u32; 3]) -> f64| places.iter().map(|place| of(*place)).sum::<f64>();
        for most in [1.01, 2.0, 5.0, 30.0, 1e9] {
            let springs = few(stiffness, variance, most);
            let sum = |of: fn(&Spring) -> f64| springs.iter().map(|(_, spring)| of(spring)).sum();
            let (k, var): (f64, f64) =
                (sum(|spring| spring.stiffness_n_per_m), sum(|spring| spring.variance));
            assert!((k - all(&stiffness)).abs() < 1e-9 * k);
            assert!((var - all(&variance)).abs() < 1e-9 * var);
            let square: f64 = sum(|spring| spring.square);
            assert!((square - all(&|place| stiffness(place).powi(2))).abs() < 1e-9 * square);
            let cells: f64 = sum(|spring| spring.stands_for);
            assert_eq!(cells, places.len() as f64);
            let mut at: Vec<_> = springs.iter().map(|(place, _)| *place).collect();
            at.sort_unstable();
            at.dedup();
            assert_eq!(at.len(), springs.len(), "a leader has one group");
            assert!(springs.iter().all(|(place, spring)| spring.is_known == (place[0] > 0)));
        }
    }

    #[test]
    fn stiff_blocks_are_divided_into_clusters_and_soft_ones_are_not() {
        let stiffness = |[i, _, _]: [u32; 3]| if i < BRICK_EDGE { 100.0 } else { 1e-3 };
        let springs = few(stiffness, |_| 1.0, 4.1);
        let stiff = springs.iter().filter(|([i, _, _], _)| *i < BRICK_EDGE).count();
        // Stiff cells weigh 1.5, the others 0.5: groups of two and of eight are within the limit of 4.1.
        assert_eq!((stiff, springs.len() - stiff), (BRICK_CELLS / 2, BRICK_CELLS / 8));
    }

    #[test]
    fn a_cluster_is_placed_where_its_stiffness_is() {
        let stiffness = |place| if place == [3, 2, 1] { 9.0 } else { 0.0 };
        let springs = few(stiffness, |_| 0.0, 1e9);
        let (_, spring) = springs.iter().find(|(place, _)| *place == [3, 2, 1]).unwrap();
        assert_eq!((spring.stiffness_n_per_m, spring.stands_for), (9.0, 64.0));
        assert_eq!(spring.offset, Vector3::zeros());
    }

    #[test]
    fn springs_push_in_the_middle_of_what_they_stand_for() {
        // For displacements that are linear in the place, the springs push as much as all cells together.
        let stiffness = |[i, j, k]: [u32; 3]| f64::from(1 + i * 7 % 5 + j * k);
        let displacement = |at: Vector3<f64>| 0.3 + at.dot(&Vector3::new(0.02, -0.05, 0.07));
        let at = |place: [u32; 3]| Vector3::from(place.map(f64::from));
        let cells =
            rows().cells().iter().map(|cell| rows().lattice().place(*cell)).collect::<Vec<_>>();
        let all: f64 = cells.iter().map(|place| stiffness(*place) * displacement(at(*place))).sum();
        for most in [2.0, 5.0, 30.0, 1e9] {
            let springs = few(stiffness, |_| 1.0, most);
            let pushes = springs.iter().map(|(place, spring)| {
                assert!(spring.offset.amax() <= 0.5 + 1e-9, "the leader is the nearest");
                spring.stiffness_n_per_m * displacement(at(*place) + spring.offset)
            });
            assert!((pushes.sum::<f64>() - all).abs() < 1e-9 * all);
        }
    }
}
