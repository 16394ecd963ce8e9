//! Which points are followed where following all would take too long.
//!
//! No point's way depends on another's, so a part of them can be followed alone, each exactly as
//! among all. A [`Chosen`] stands for all points, and whoever chooses knows for how many others each
//! of them stands; [`Share`]s are all points between them, for as many threads.

use crate::lattice::{BRICK_EDGE, BrickBits, Bricks};

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
    /// Those that are followed, in bricks where any point is known.
    bricks: Bricks<BrickBits>,
}

/// Edge of a block in which one point stands for all that are not known.
const EDGE: u32 = 4;

impl Chosen {
    /// For how many points one stands that is not known.
    pub(crate) const ONE_IN: f64 = (EDGE * EDGE * EDGE) as f64;

    /// Says which points of a brick, counted in bricks, are known, and which of those are followed.
    pub(crate) fn choose(&mut self, brick: [u32; 3], known: &BrickBits, leads: &BrickBits) {
        let followed = self.bricks.get_or_insert_with(brick, || *leads);
        for place in representatives(brick.map(|n| n * BRICK_EDGE)) {
            let (_, inside) = Bricks::<()>::locate(place);
            if !known.get(inside) {
                followed.insert(inside);
            }
        }
    }

    /// Whether a point is followed.
    pub(super) fn contains(&self, place: [u32; 3]) -> bool {
        let (brick, inside) = Bricks::<()>::locate(place);
        match self.bricks.get(brick) {
            Some(followed) => followed.get(inside),
            None => place == representative(place.map(|n| n / EDGE)),
        }
    }

    /// The points that are followed of the brick of a place.
    pub(super) fn of_brick(&self, place: [u32; 3]) -> BrickBits {
        let (brick, _) = Bricks::<()>::locate(place);
        self.bricks.get(brick).copied().unwrap_or_else(|| {
            let mut followed = BrickBits::default();
            for place in representatives(brick.map(|n| n * BRICK_EDGE)) {
                followed.insert(Bricks::<()>::locate(place).1);
            }
            followed
        })
    }
}

/// The points that stand for the blocks of a brick, by its first place.
fn representatives(low: [u32; 3]) -> impl Iterator<Item = [u32; 3]> {
    let n = BRICK_EDGE / EDGE;
    (0..n.pow(3)).map(move |block| {
        let block = [block % n, block / n % n, block / (n * n)];
        representative([0, 1, 2].map(|axis| low[axis] / EDGE + block[axis]))
    })
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
        assert_eq!(followed, points.of_brick(low).places(low).collect::<Vec<_>>());
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
        let bits = |places: &[[u32; 3]]| {
            let mut bits = BrickBits::default();
            places.iter().for_each(|place| bits.insert(Bricks::<()>::locate(*place).1));
            bits
        };
        let all: Vec<_> = places([8, 16, 72]).collect();
        points.choose([1, 2, 9], &bits(&all), &bits(&[[9, 20, 79]]));
        assert_eq!(followed(&points, [8, 16, 72]), [[9, 20, 79]]);
        // A point that is known stands for itself alone, or for none.
        let others = followed(&points, [8, 16, 64]);
        points.choose([1, 2, 8], &bits(&others[..1]), &BrickBits::default());
        assert_eq!(followed(&points, [8, 16, 64]), others[1..]);
    }
}
