//! Which springs of a field stand for which others where an answer must come fast.
//!
//! Neighbours are displaced alike, so one of them, with the stiffness of all, pushes nearly as they
//! do together. Groups are blocks of 4³ cells, or half of one, or half of that, down to single
//! cells: a block is halved as long as it *weighs* more than a bound, so that no spring adds much
//! more to an answer than any other. A cell weighs what it may add to the torque and to its
//! variance, each against the mean.

use nalgebra::Vector3;

use crate::contact::Chosen;
use crate::lattice::{BRICK_CELLS, BrickBits, Bricks, CellRows};

/// The largest block has 2 to the power of this many cells; half of it, of one less.
const LARGEST: u32 = 6;

/// The springs that stand for groups.
#[derive(Debug)]
pub(super) struct Leaders {
    /// By row.
    pub(super) leaders: Vec<Leader>,
    /// Where they are, and what stands for cells of which the field knows nothing.
    pub(super) chosen: Chosen,
}

/// A spring that stands for a group.
#[derive(Debug, Clone, Copy)]
pub(super) struct Leader {
    /// Its row in the field.
    pub(super) row: usize,
    /// Sum of the stiffness of the group, N/m.
    pub(super) stiffness_n_per_m: f64,
    /// Sum of the variances of the group, (N/m)².
    pub(super) variance: f64,
    /// Cells of the group.
    pub(super) stands_for: f64,
}

/// What is known of a cell.
#[derive(Debug, Clone, Copy)]
pub(super) struct Spring {
    /// K, N/m.
    pub(super) stiffness_n_per_m: f64,
    /// Its variance, (N/m)².
    pub(super) variance: f64,
}

/// A cell of a brick that the field knows.
#[derive(Debug, Clone, Copy)]
struct Known {
    /// Its number in the brick, if cells come block by block: [`place`] says where that is.
    number: usize,
    row: usize,
    weight: f64,
    stiffness_n_per_m: f64,
}

impl Leaders {
    /// The leaders of cells with these springs, by row, in groups of which none weighs more than
    /// `most` cells of the mean unless it is a single one.
    ///
    /// Cost: some 20 ns a cell.
    pub(super) fn new(rows: &CellRows, springs: &[Spring], most: f64) -> Self {
        let (mut leaders, mut chosen) = (Vec::new(), Chosen::default());
        let per_cell = |of: fn(&Spring) -> f64| {
            let sum: f64 = springs.iter().map(of).sum();
            if sum > 0.0 { springs.len() as f64 / sum } else { 0.0 }
        };
        let per_stiffness = per_cell(|spring| spring.stiffness_n_per_m);
        let per_variance = per_cell(|spring| spring.variance);
        let inside: [usize; BRICK_CELLS] = std::array::from_fn(inside);
        let places: [_; BRICK_CELLS] = std::array::from_fn(|n| place(n).map(|n| n as f64).into());
        let mut cells: Vec<Known> = Vec::with_capacity(BRICK_CELLS);
        for (brick, rows) in rows.bricks() {
            let (mut known, mut leads) = (BrickBits::default(), BrickBits::default());
            cells.clear();
            for (number, &inside) in inside.iter().enumerate() {
                let row = rows[inside] as usize;
                if let Some(&Spring { stiffness_n_per_m, variance }) = springs.get(row) {
                    let weight =
                        (stiffness_n_per_m * per_stiffness + variance * per_variance) / 2.0;
                    cells.push(Known { number, row, weight, stiffness_n_per_m });
                    known.insert(inside);
                }
            }
            divide(&cells, most, &mut |group| {
                let first = leader(group, &places);
                leads.insert(inside[first.number]);
                leaders.push(Leader {
                    row: first.row,
                    stiffness_n_per_m: group.iter().map(|cell| cell.stiffness_n_per_m).sum(),
                    variance: group.iter().map(|cell| springs[cell.row].variance).sum(),
                    stands_for: group.len() as f64,
                });
            });
            chosen.choose(brick, &known, &leads);
        }
        leaders.sort_unstable_by_key(|leader| leader.row);
        Self { leaders, chosen }
    }
}

/// The number that the n-th cell has inside its brick elsewhere.
fn inside(n: usize) -> usize {
    let (_, inside) = Bricks::<()>::locate(place(n).map(|n| n as u32));
    inside
}

/// Where the n-th cell lies in its brick: its bits are those of x, y and z in turn, so that the cells
/// of a block come in a row.
fn place(n: usize) -> [usize; 3] {
    std::array::from_fn(|axis| (0..3).map(|bit| (n >> (3 * bit + axis) & 1) << bit).sum())
}

/// Calls `group` with every group among the cells of a brick, which come by number.
fn divide(cells: &[Known], most: f64, group: &mut impl FnMut(&[Known])) {
    for block in cells.chunk_by(|a, b| a.number >> LARGEST == b.number >> LARGEST) {
        halve(block, LARGEST, most, group);
    }
}

/// Calls `group` with every group of a block of two to the power of `size` cells.
fn halve(cells: &[Known], size: u32, most: f64, group: &mut impl FnMut(&[Known])) {
    if cells.len() > 1 && cells.iter().map(|cell| cell.weight).sum::<f64>() > most {
        let size = size - 1;
        let half = cells.partition_point(|cell| cell.number >> size & 1 == 0);
        halve(&cells[..half], size, most, group);
        halve(&cells[half..], size, most, group);
    } else if !cells.is_empty() {
        group(cells);
    }
}

/// The cell of a group that stands for all: the nearest to the middle of their stiffness.
fn leader(group: &[Known], places: &[Vector3<f64>; BRICK_CELLS]) -> Known {
    if let [single] = group {
        return *single;
    }
    let (mut middle, mut sum) = (Vector3::zeros(), 0.0);
    for cell in group {
        let weight = cell.stiffness_n_per_m + f64::MIN_POSITIVE; // all may be 0
        middle += places[cell.number] * weight;
        sum += weight;
    }
    middle /= sum;
    let away = |cell: &Known| (places[cell.number] - middle).norm_squared();
    *group.iter().min_by(|a, b| away(a).total_cmp(&away(b))).expect("a group is never empty")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::{BRICK_EDGE, Lattice};

    /// Rows of all cells of two bricks of a lattice, and springs for them, by place and by row.
    fn field(
        stiffness_n_per_m: impl Fn([u32; 3]) -> f64,
        variance: impl Fn(usize) -> f64,
    ) -> (CellRows, Vec<Spring>) {
        let lattice = Lattice::new([0.0; 3], 0.01, [2 * BRICK_EDGE, BRICK_EDGE, BRICK_EDGE]);
        let mut rows = CellRows::new(lattice.unwrap());
        for number in 0..2 * BRICK_CELLS as u32 {
            rows.row_of(crate::lattice::CellId(number));
        }
        let spring = |(row, &cell)| Spring {
            stiffness_n_per_m: stiffness_n_per_m(rows.lattice().place(cell)),
            variance: variance(row),
        };
        let springs = rows.cells().iter().enumerate().map(spring).collect();
        (rows, springs)
    }

    #[test]
    fn groups_hold_every_cell_once_with_all_its_stiffness_and_variance() {
        let stiffness = |[i, j, k]: [u32; 3]| f64::from(i * 7 % 5 + j * k);
        let (rows, springs) = field(stiffness, |row| (row % 11) as f64);
        for most in [0.0, 1.0, 5.0, 30.0, 1e9] {
            let leaders = Leaders::new(&rows, &springs, most);
            let sum = |of: fn(&Leader) -> f64| leaders.leaders.iter().map(of).sum::<f64>();
            let stiffness: f64 = springs.iter().map(|spring| spring.stiffness_n_per_m).sum();
            let variance: f64 = springs.iter().map(|spring| spring.variance).sum();
            assert!((sum(|one| one.stiffness_n_per_m) - stiffness).abs() < 1e-9 * stiffness);
            assert!((sum(|one| one.variance) - variance).abs() < 1e-9 * variance);
            assert_eq!(sum(|one| one.stands_for), springs.len() as f64);
            assert!(leaders.leaders.is_sorted_by(|a, b| a.row < b.row), "a leader has one group");
        }
    }

    #[test]
    fn what_is_stiff_is_divided_and_what_is_not_is_not() {
        let stiffness = |[i, _, _]: [u32; 3]| if i < BRICK_EDGE { 100.0 } else { 1e-3 };
        let (rows, springs) = field(stiffness, |_| 1.0);
        let leaders = Leaders::new(&rows, &springs, 4.1);
        let groups = |of_stiff: bool| {
            let is_stiff = |row: usize| rows.lattice().place(rows.cells()[row])[0] < BRICK_EDGE;
            leaders.leaders.iter().filter(|leader| is_stiff(leader.row) == of_stiff).count()
        };
        // Stiff cells weigh 1.5, the others 0.5: two and eight of them weigh no more than may be.
        assert_eq!((groups(true), groups(false)), (BRICK_CELLS / 2, BRICK_CELLS / 8));
    }

    #[test]
    fn the_leader_is_where_the_stiffness_is() {
        let stiffness = |place| if place == [3, 2, 1] { 9.0 } else { 0.0 };
        let (rows, springs) = field(stiffness, |_| 0.0);
        let leaders = Leaders::new(&rows, &springs, 1e9);
        let row = rows.find(rows.lattice().cell([3, 2, 1])).unwrap() as usize;
        let leader = leaders.leaders.iter().find(|leader| leader.row == row).unwrap();
        assert_eq!((leader.stiffness_n_per_m, leader.stands_for), (9.0, 64.0));
    }
}
