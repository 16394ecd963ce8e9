//! Storage in bricks of 8³ cells, which exist only where cells were touched.

use rustc_hash::FxHashMap;

/// Cells along one edge of a brick.
pub(crate) const BRICK_EDGE: u32 = 8;
/// Cells in a brick.
pub(crate) const BRICK_CELLS: usize = (BRICK_EDGE * BRICK_EDGE * BRICK_EDGE) as usize;

/// Values of cells in bricks of 8³. A brick is created when one of its cells is first used.
///
/// Memory depends on the bricks in use, not on the size of the lattice.
#[derive(Debug, Clone)]
pub(crate) struct Bricks<T> {
    slots: FxHashMap<[u32; 3], u32>,
    bricks: Vec<T>,
}

impl<T> Default for Bricks<T> {
    fn default() -> Self {
        Self { slots: FxHashMap::default(), bricks: Vec::new() }
    }
}

impl<T> Bricks<T> {
    /// The brick of a place, and the place's number inside it (0..512).
    pub(crate) fn locate(place: [u32; 3]) -> ([u32; 3], usize) {
        let [i, j, k] = place.map(|n| n % BRICK_EDGE);
        (place.map(|n| n / BRICK_EDGE), (i + BRICK_EDGE * (j + BRICK_EDGE * k)) as usize)
    }

    /// The values of a brick, if it is in use.
    pub(crate) fn get(&self, brick: [u32; 3]) -> Option<&T> {
        self.slots.get(&brick).map(|&slot| &self.bricks[slot as usize])
    }

    /// The values of a brick, made with `fresh` at first use.
    pub(crate) fn get_or_insert_with(
        &mut self,
        brick: [u32; 3],
        fresh: impl FnOnce() -> T,
    ) -> &mut T {
        let slot = *self.slots.entry(brick).or_insert_with(|| {
            self.bricks.push(fresh());
            (self.bricks.len() - 1) as u32
        });
        &mut self.bricks[slot as usize]
    }

    /// Removes all bricks.
    pub(crate) fn clear(&mut self) {
        self.slots.clear();
        self.bricks.clear();
    }
}

/// A bit for each cell of a brick.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct BrickBits([u64; BRICK_CELLS / 64]);

impl BrickBits {
    /// The bit of a cell, by its number inside the brick.
    pub(crate) fn get(&self, inside: usize) -> bool {
        self.0[inside / 64] >> (inside % 64) & 1 == 1
    }

    /// Sets the bit of a cell, by its number inside the brick.
    pub(crate) fn insert(&mut self, inside: usize) {
        self.0[inside / 64] |= 1 << (inside % 64);
    }

    /// Whether all bits of a cube of `edge` cells a side are set; `low` is its first place.
    ///
    /// A 64-bit word is one layer along z, a byte of it one row along x: one comparison per layer.
    ///
    /// # Panics
    ///
    /// If the cube reaches beyond the brick that `low` lies in, which is a bug in the caller.
    pub(crate) fn holds_cube(&self, low: [u32; 3], edge: u32) -> bool {
        let [i, j, k] = low.map(|n| n % BRICK_EDGE);
        let layer = layer([i, j, k], edge);
        (k..k + edge).all(|k| self.0[k as usize] & layer == layer)
    }
}

/// The bits that a cube has in each layer of its brick.
fn layer(low_inside: [u32; 3], edge: u32) -> u64 {
    assert!(low_inside.iter().all(|n| n + edge <= BRICK_EDGE), "a cube must lie within one brick");
    let [i, j, _] = low_inside;
    let row = u64::MAX >> (64 - edge) << i;
    (j..j + edge).fold(0, |layer, j| layer | row << (BRICK_EDGE * j))
}

/// A set of cells, a bit each, in bricks.
#[derive(Debug, Clone, Default)]
pub(crate) struct CellSet {
    bricks: Bricks<BrickBits>,
}

impl CellSet {
    /// Whether the set holds the cell at a place.
    pub(crate) fn contains(&self, place: [u32; 3]) -> bool {
        let (brick, inside) = Bricks::<()>::locate(place);
        self.bricks.get(brick).is_some_and(|bits| bits.get(inside))
    }

    /// Whether the set holds every cell of a cube of `edge` cells a side; `low` is its first place.
    ///
    /// # Panics
    ///
    /// If the cube reaches beyond the brick that `low` lies in, which is a bug in the caller.
    pub(crate) fn holds_cube(&self, low: [u32; 3], edge: u32) -> bool {
        let (brick, _) = Bricks::<()>::locate(low);
        self.bricks.get(brick).is_some_and(|bits| bits.holds_cube(low, edge))
    }

    /// Adds the cell at a place.
    pub(crate) fn insert(&mut self, place: [u32; 3]) {
        let (brick, inside) = Bricks::<()>::locate(place);
        self.bricks.get_or_insert_with(brick, BrickBits::default).insert(inside);
    }

    /// Removes the cell at a place.
    pub(crate) fn remove(&mut self, place: [u32; 3]) {
        let (brick, inside) = Bricks::<()>::locate(place);
        let bits = self.bricks.get_or_insert_with(brick, BrickBits::default);
        bits.0[inside / 64] &= !(1 << (inside % 64));
    }

    /// Removes all cells.
    pub(crate) fn clear(&mut self) {
        self.bricks.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_set_holds_what_was_put_in_and_not_taken_out() {
        let mut set = CellSet::default();
        set.insert([7, 8, 9]);
        set.insert([7, 8, 10]);
        set.remove([7, 8, 10]);
        assert!(set.contains([7, 8, 9]));
        assert!(!set.contains([7, 8, 10]) && !set.contains([0, 0, 0]));
    }

    #[test]
    fn a_cube_is_held_if_each_of_its_cells_is() {
        for (low, edge) in [([8, 16, 24], 8), ([12, 16, 28], 4), ([14, 20, 26], 2), ([9, 9, 9], 1)]
        {
            let mut set = CellSet::default();
            let inside = (0..edge)
                .flat_map(|i| (0..edge).flat_map(move |j| (0..edge).map(move |k| [i, j, k])));
            let places: Vec<_> =
                inside.map(|[i, j, k]| [low[0] + i, low[1] + j, low[2] + k]).collect();
            for place in &places {
                assert!(!set.holds_cube(low, edge));
                set.insert(*place);
            }
            assert!(set.holds_cube(low, edge));
            set.remove(places[places.len() / 2]);
            assert!(!set.holds_cube(low, edge));
        }
    }
}
