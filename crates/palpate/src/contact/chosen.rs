//! Which points are followed where following all would take too long.
//!
//! No point's way depends on another's, so a part of them can be followed alone, each exactly as
//! among all; whoever chooses knows for how many others each of them stands.

use crate::lattice::CellSet;

/// The points that are followed: some of those that are known, and of all others one in every block
/// of 2³.
///
/// Those stand on planes askew to the axes, so that a flat face of a link, which mostly lies along
/// one, has as many of them wherever it is.
#[derive(Debug, Default)]
pub(crate) struct Chosen {
    known: CellSet,
    chosen: CellSet,
}

impl Chosen {
    /// For how many points one stands that is not known.
    pub(crate) const ONE_IN: f64 = 8.0;

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
        let [i, j, k] = place;
        (i % 8 + 2 * (j % 4) + 4 * (k % 2)) % 8 == 0
    }

    /// Whether a cube of `edge` cells a side may have a point that is followed.
    pub(super) fn may_touch(&self, low: [u32; 3], edge: u32) -> bool {
        match edge {
            1 => self.contains(low),
            _ => self.chosen.touches_cube(low, edge) || !self.known.holds_cube(low, edge),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_what_is_not_known_every_block_has_one_and_of_what_is_none_but_the_chosen() {
        let mut points = Chosen::default();
        let block = |low: [u32; 3]| {
            let beside = move |n: u32, axis: usize| low[axis] + (n >> axis & 1);
            (0..8).map(move |n| [beside(n, 0), beside(n, 1), beside(n, 2)])
        };
        for low in [[0, 0, 0], [6, 2, 14], [2, 4, 8]] {
            assert_eq!(block(low).filter(|place| points.contains(*place)).count(), 1, "{low:?}");
            assert!(points.may_touch(low, 2));
        }
        block([2, 4, 8]).for_each(|place| points.insert(place, false));
        assert!(!points.may_touch([2, 4, 8], 2) && points.may_touch([0, 4, 8], 4));
        points.insert([3, 4, 9], true);
        assert_eq!(block([2, 4, 8]).filter(|place| points.contains(*place)).count(), 1);
        assert!(points.contains([3, 4, 9]) && points.may_touch([2, 4, 8], 2));
    }
}
