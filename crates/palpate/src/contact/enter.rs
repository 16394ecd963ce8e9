//! Which free points a link covers: an octree descent over the lattice around it.
//!
//! φ is a distance: at the centre of a block of cells it bounds φ everywhere in the block, so
//! whole blocks away from the link are passed over with one look, and so are blocks inside it
//! whose cells are all taken already.

use nalgebra::{Isometry3, Point3, Vector3};

use crate::lattice::{BRICK_EDGE, BrickBits, CellSet, Lattice};
use crate::sdf::Grid;

/// A free point inside an inflated link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Entered {
    pub(super) place: [u32; 3],
    pub(super) link: usize,
    pub(super) distance_m: f64,
}

/// What a search needs to know besides the link.
pub(super) struct Search<'a> {
    pub(super) lattice: &'a Lattice,
    pub(super) taken: &'a CellSet,
    /// δ.
    pub(super) reach_m: f64,
}

/// How much more than a distance the baked φ may change between two points, as a factor:
/// trilinear interpolation of a distance is not quite 1-Lipschitz.
const LIPSCHITZ: f64 = 1.1;

/// The box of a link's surface, as eight points of its frame.
pub(super) fn corners(surface: &Grid) -> [Point3<f64>; 8] {
    let (low, high) = surface.bounds();
    std::array::from_fn(|corner| {
        let pick = |axis: usize| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] };
        Point3::new(pick(0), pick(1), pick(2))
    })
}

impl Search<'_> {
    /// Adds the free points with φ < δ of one link to `found`.
    pub(super) fn collect(
        &self,
        link: usize,
        surface: &Grid,
        world_from_link: &Isometry3<f64>,
        found: &mut Vec<Entered>,
    ) {
        let (first, end) = self.places_near(surface, world_from_link);
        let bricks = |axis: usize| (first[axis] / BRICK_EDGE)..end[axis].div_ceil(BRICK_EDGE);
        if (0..3).any(|axis| first[axis] >= end[axis]) {
            return;
        }
        for k in bricks(2) {
            for j in bricks(1) {
                for i in bricks(0) {
                    let (brick, pose) = ([i, j, k], world_from_link);
                    let taken = self.taken.brick(brick);
                    let descent = Descent { search: self, taken, link, surface, pose, first, end };
                    descent.visit(brick.map(|n| n * BRICK_EDGE), BRICK_EDGE, found);
                }
            }
        }
    }

    /// The places that the link's box, inflated by δ, can reach.
    fn places_near(&self, surface: &Grid, pose: &Isometry3<f64>) -> ([u32; 3], [u32; 3]) {
        let mut low = Point3::from(Vector3::repeat(f64::INFINITY));
        let mut high = Point3::from(Vector3::repeat(f64::NEG_INFINITY));
        for corner in corners(surface) {
            let corner = pose * corner;
            low = low.inf(&corner);
            high = high.sup(&corner);
        }
        let reach = Vector3::repeat(self.reach_m);
        self.lattice.places_within(&(low - reach), &(high + reach))
    }
}

/// One link's descent in one brick.
struct Descent<'a> {
    search: &'a Search<'a>,
    /// The cells of the brick that cannot be entered.
    taken: BrickBits,
    link: usize,
    surface: &'a Grid,
    pose: &'a Isometry3<f64>,
    first: [u32; 3],
    end: [u32; 3],
}

impl Descent<'_> {
    /// Looks at the block of `edge`³ cells whose first place is `low`.
    fn visit(&self, low: [u32; 3], edge: u32, found: &mut Vec<Entered>) {
        if (0..3).any(|axis| low[axis] >= self.end[axis] || low[axis] + edge <= self.first[axis]) {
            return;
        }
        if self.taken.holds_cube(low, edge) {
            return;
        }
        if edge == 1 {
            return self.visit_cell(low, found);
        }
        let half_cells = f64::from(edge - 1) / 2.0;
        let spacing_m = self.search.lattice.spacing_m();
        let centre = self.search.lattice.point_at(low) + Vector3::repeat(half_cells * spacing_m);
        let radius_m = half_cells * spacing_m * 3f64.sqrt();
        let distance_m = self.surface.distance(&self.pose.inverse_transform_point(&centre));
        if distance_m > self.search.reach_m + LIPSCHITZ * radius_m {
            return;
        }
        let half = edge / 2;
        for octant in 0..8 {
            let step = [octant & 1, octant >> 1 & 1, octant >> 2].map(|bit| bit * half);
            self.visit([low[0] + step[0], low[1] + step[1], low[2] + step[2]], half, found);
        }
    }

    /// Takes a single free cell if it is covered.
    fn visit_cell(&self, place: [u32; 3], found: &mut Vec<Entered>) {
        let rest = self.search.lattice.point_at(place);
        let distance_m = self.surface.distance(&self.pose.inverse_transform_point(&rest));
        if distance_m < self.search.reach_m {
            found.push(Entered { place, link: self.link, distance_m });
        }
    }
}

/// Keeps every place once, with the link that covers it deepest, in the lattice's order.
pub(super) fn keep_deepest(found: &mut Vec<Entered>) {
    found.sort_by(|a, b| {
        let key = |entered: &Entered| [entered.place[2], entered.place[1], entered.place[0]];
        key(a).cmp(&key(b)).then(a.distance_m.total_cmp(&b.distance_m)).then(a.link.cmp(&b.link))
    });
    found.dedup_by_key(|entered| entered.place);
}
