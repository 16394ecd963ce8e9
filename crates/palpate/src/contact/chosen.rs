//! Which points are followed where following all would take too long.
//!
//! No point's way depends on another's, so a part of them can be followed alone, each exactly as
//! among all. A [`Chosen`] stands for all points, and whoever chooses knows for how many others each
//! of them stands; [`Share`]s are all points between them, for as many threads.

use crate::lattice::{BRICK_EDGE, CellSet};

/// One of so many shares of the points: bricks in turn, so that a link that touches many has some of
/// each share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Share {
    /// Number of the share, from 0.
    pub(crate) part: u32,
    /// How many there are.
    pub(crate) of: u32,
}

impl Share {
    /// All points.
    pub(crate) const WHOLE: Self = Self { part: 0, of: 1 };

    /// Whether a point, and all of its brick, belong to this share.
    pub(super) fn holds(self, place: [u32; 3]) -> bool {
        place.iter().map(|n| n / BRICK_EDGE).sum::<u32>() % self.of == self.part
    }
}

/// The points that are followed: some of those that are known, and of all others one in every block
/// of 4³.
#[derive(Debug, Default)]
pub(crate) struct Chosen {
    known: CellSet,
    chosen: CellSet,
}

/// Edge of a block in which one point stands for all that are not known.
const EDGE: u32 = 4;

impl Chosen {
    /// For how many points one stands that is not known.
    pub(crate) const ONE_IN: f64 = (EDGE * EDGE * EDGE) as f64;

    /// Makes a point known, and says whether it is followed.
    pub(crate) fn insert(&mut self, place: [u32; 3], chosen: bool) {
        self.known.insert(place);
        if chosen {
            self.chosen.insert(place);
        }
    }

    /// Whether a point is followed.
    pub(super) fn contains(&self, place: [u32; 3]) -> bool {
        if self.known.contains(place) {
            return self.chosen.contains(place);
        }
        place == representative(place.map(|n| n / EDGE))
    }

    /// The points of a brick that are followed, by its first place.
    pub(super) fn of_brick(&self, low: [u32; 3]) -> impl Iterator<Item = [u32; 3]> {
        let blocks = BRICK_EDGE / EDGE;
        let others = (0..blocks.pow(3)).map(move |n| {
            let block = [n % blocks, n / blocks % blocks, n / (blocks * blocks)];
            representative([0, 1, 2].map(|axis| low[axis] / EDGE + block[axis]))
        });
        self.chosen.of_brick(low).chain(others.filter(|place| !self.known.contains(*place)))
    }
}

/// The point that stands for those of its block.
///
/// It lies elsewhere in every block, so that a flat face of a link, which mostly lies along an axis,
/// meets as many of them wherever it is.
fn representative([i, j, k]: [u32; 3]) -> [u32; 3] {
    let inside = [j + 2 * k, k + 2 * i, i + 2 * j];
    std::array::from_fn(|axis| EDGE * [i, j, k][axis] + inside[axis] % EDGE)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All places of a brick, in the lattice's order.
    fn places(low: [u32; 3]) -> impl Iterator<Item = [u32; 3]> {
        let n = BRICK_EDGE;
        (0..n.pow(3)).map(move |at| [low[0] + at % n, low[1] + at / n % n, low[2] + at / (n * n)])
    }

    /// The points of a brick that are followed, asked for one by one.
    fn followed(points: &Chosen, low: [u32; 3]) -> Vec<[u32; 3]> {
        let followed: Vec<_> = places(low).filter(|place| points.contains(*place)).collect();
        let mut together: Vec<_> = points.of_brick(low).collect();
        together.sort_by_key(|[i, j, k]| [*k, *j, *i]);
        assert_eq!(followed, together);
        followed
    }

    #[test]
    fn of_what_is_not_known_every_block_has_one_and_of_what_is_none_but_the_chosen() {
        let mut points = Chosen::default();
        for low in [[0, 0, 0], [8, 16, 72]] {
            let mut blocks: Vec<_> =
                followed(&points, low).iter().map(|place| place.map(|n| n / EDGE)).collect();
            blocks.sort_unstable();
            blocks.dedup();
            assert_eq!(blocks.len(), 8, "{low:?}");
        }
        places([8, 16, 72]).for_each(|place| points.insert(place, false));
        assert!(followed(&points, [8, 16, 72]).is_empty());
        points.insert([9, 20, 79], true);
        assert_eq!(followed(&points, [8, 16, 72]), [[9, 20, 79]]);
        assert_eq!(followed(&points, [8, 16, 64]).len(), 8);
    }
}
