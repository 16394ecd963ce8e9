//! The free points that links have come to cover, and where to look for them.

use nalgebra::{Point3, Vector3};

use super::broad_phase;
use super::placed::Placed;
use crate::lattice::{BRICK_EDGE, CellSet, Lattice};
use crate::sdf::DistanceGrid;

/// A free point inside an inflated link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Entered {
    pub(super) place: [u32; 3],
    pub(super) link: usize,
    pub(super) distance_m: f64,
}

/// How much more than a distance the baked φ may change between two points, as a factor:
/// trilinear interpolation of a distance is not quite 1-Lipschitz.
pub(super) const LIPSCHITZ: f64 = 1.1;

/// What a look needs to know besides the broad_phase.
pub(super) struct Query<'a> {
    pub(super) lattice: &'a Lattice,
    /// Places that cannot be entered.
    pub(super) taken: &'a CellSet,
    /// δ.
    pub(super) reach_m: f64,
    pub(super) link: usize,
    pub(super) surface: &'a DistanceGrid,
    pub(super) placed: Placed,
}

impl Query<'_> {
    /// The bricks, by their first places, that the link can reach within a horizon.
    pub(super) fn bricks_near(&self) -> impl Iterator<Item = [u32; 3]> + use<> {
        let (low, high) = self.placed.bounds(self.surface);
        let reach = Vector3::repeat(broad_phase::within_m(self.reach_m));
        bricks_within(self.lattice, &(low - reach), &(high + reach))
    }
}

/// The bricks of a box, by their first places.
pub(super) fn bricks_within(
    lattice: &Lattice,
    low: &Point3<f64>,
    high: &Point3<f64>,
) -> impl Iterator<Item = [u32; 3]> + use<> {
    let (first, end) = lattice.places_within(low, high);
    let bricks = |axis: usize| match first[axis] < end[axis] {
        true => first[axis] / BRICK_EDGE..end[axis].div_ceil(BRICK_EDGE),
        false => 0..0,
    };
    let [x, y, z] = [0, 1, 2].map(bricks);
    let columns = z.flat_map(move |k| y.clone().map(move |j| [j, k]));
    let bricks = columns.flat_map(move |[j, k]| x.clone().map(move |i| [i, j, k]));
    bricks.map(|brick| brick.map(|n| n * BRICK_EDGE))
}

/// Keeps every place once, with the link that covers it deepest, in the lattice's order.
pub(super) fn keep_deepest(found: &mut Vec<Entered>) {
    found.sort_by(|a, b| {
        let key = |entered: &Entered| [entered.place[2], entered.place[1], entered.place[0]];
        key(a).cmp(&key(b)).then(a.distance_m.total_cmp(&b.distance_m)).then(a.link.cmp(&b.link))
    });
    found.dedup_by_key(|entered| entered.place);
}
