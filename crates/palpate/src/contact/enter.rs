//! Which free points a link has come to cover, without looking where it cannot have.
//!
//! φ is a distance: at the centre of a block of cells it bounds φ everywhere in the block, and a
//! block that is far from the link stays free until the link has travelled as far. So every link
//! keeps a [`Watch`]: an agenda of blocks, each due when the link may have reached it. A motion
//! looks at what has become due; a block that may hold covered points is split, and whatever is
//! still free goes back on the agenda. What a motion costs follows the link's surface and how far
//! it went, and what is found is the same as if every point had been looked at.

use nalgebra::{Isometry3, Point3, Rotation3, Vector3};

use super::chosen::{Chosen, Share};
use crate::lattice::{BRICK_EDGE, CellSet, Lattice};
use crate::sdf::Grid;

/// A free point inside an inflated link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Entered {
    pub(super) place: [u32; 3],
    pub(super) link: usize,
    pub(super) distance_m: f64,
}

/// How much more than a distance the baked φ may change between two points, as a factor:
/// trilinear interpolation of a distance is not quite 1-Lipschitz.
const LIPSCHITZ: f64 = 1.1;

/// How far a link may travel before its agenda is written anew; blocks due later are left out.
const HORIZON_M: f64 = 0.02;

/// Travel that shares a page of the agenda.
const PAGE_M: f64 = 0.001;

/// The box of a link's surface, as eight points of its frame.
pub(super) fn corners(surface: &Grid) -> [Point3<f64>; 8] {
    let (low, high) = surface.bounds();
    std::array::from_fn(|corner| {
        let pick = |axis: usize| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] };
        Point3::new(pick(0), pick(1), pick(2))
    })
}

/// What a look needs to know besides the agenda.
pub(super) struct Look<'a> {
    pub(super) lattice: &'a Lattice,
    /// Places that cannot be entered.
    pub(super) taken: &'a CellSet,
    /// Those that can, if not all others.
    pub(super) chosen: Option<&'a Chosen>,
    /// Those that are looked at at all.
    pub(super) share: Share,
    /// δ.
    pub(super) reach_m: f64,
    pub(super) link: usize,
    pub(super) surface: &'a Grid,
    pub(super) pose: &'a Isometry3<f64>,
    /// The pose's rotation as a matrix, which turns points faster.
    pub(super) rotation: Rotation3<f64>,
}

/// A cube of cells, at its first place, of 8, 4, 2 or 1 cells a side.
#[derive(Debug, Clone, Copy)]
struct Block {
    low: [u32; 3],
    edge: u32,
}

/// When a block must be looked at again.
#[derive(Debug, Clone, Copy)]
struct Due {
    travel_m: f64,
    block: Block,
}

/// So few points of a block are looked at one by one.
const FEW: u32 = 2;

/// Blocks looked at together.
const HANDFUL: usize = 8;

/// One link's agenda.
#[derive(Debug, Clone, Default)]
pub(super) struct Watch {
    /// How far, at most, any point within reach has moved in the link's frame since the agenda
    /// was written.
    travel_m: f64,
    /// Blocks by the travel at which they are due, a page each [`PAGE_M`]; none: not written yet.
    pages: Vec<Vec<Due>>,
    /// The first page that may hold anything.
    current: usize,
    /// Room for the blocks of a look and their parts, kept from look to look.
    room: [Vec<Block>; 2],
}

impl Watch {
    /// Forgets the agenda: the next look is at everything.
    pub(super) fn clear(&mut self) {
        self.pages.clear();
    }

    /// Adds a motion of the link to its travel.
    ///
    /// In the link's frame a point x moves to `x' = M x` with `M = to⁻¹ from`; within a ball about
    /// the middle c of the link's box no point moves further than `|M c − c| + 2 sin(θ/2) ρ`. Only
    /// points in the ball of all that is within reach or on the agenda are asked for: one from
    /// outside comes nearer by at most `|M c − c|` a motion.
    pub(super) fn travel(
        &mut self,
        surface: &Grid,
        reach_m: f64,
        from: &Isometry3<f64>,
        to: &Isometry3<f64>,
    ) {
        let (low, high) = surface.bounds();
        let (middle, half) = (nalgebra::center(&low, &high), (high - low) / 2.0);
        let motion = to.inv_mul(from);
        let chord = 2.0 * motion.rotation.imag().norm();
        let radius_m = half.norm() + reach_m + LIPSCHITZ * HORIZON_M;
        self.travel_m += (motion * middle - middle).norm() + chord * radius_m;
    }

    /// Adds the free points with φ < δ that the link has come to cover to `found`.
    pub(super) fn look(&mut self, look: &Look<'_>, found: &mut Vec<Entered>) {
        if self.pages.is_empty() || self.travel_m >= HORIZON_M {
            return self.look_everywhere(look, found);
        }
        let page = (self.travel_m / PAGE_M) as usize;
        let mut due = std::mem::take(&mut self.room[0]);
        for passed in &mut self.pages[self.current..page] {
            due.extend(passed.drain(..).map(|due| due.block));
        }
        let travel_m = self.travel_m;
        due.extend(
            self.pages[page].extract_if(.., |due| due.travel_m <= travel_m).map(|due| due.block),
        );
        self.current = page;
        self.visit(look, due, found);
    }

    /// Puts a place that has become free on the agenda, or adds it to `found`.
    pub(super) fn look_at(&mut self, look: &Look<'_>, place: [u32; 3], found: &mut Vec<Entered>) {
        if !self.pages.is_empty() {
            let mut due = std::mem::take(&mut self.room[0]);
            due.push(Block { low: place, edge: 1 });
            self.visit(look, due, found);
        }
    }

    /// Writes the agenda anew, from every brick that the link can reach before the next time.
    fn look_everywhere(&mut self, look: &Look<'_>, found: &mut Vec<Entered>) {
        self.pages.resize((HORIZON_M / PAGE_M) as usize + 1, Vec::new());
        self.pages.iter_mut().for_each(Vec::clear);
        (self.travel_m, self.current) = (0.0, 0);
        let (first, end) = look.places_near();
        if (0..3).any(|axis| first[axis] >= end[axis]) {
            return;
        }
        let bricks = |axis: usize| (first[axis] / BRICK_EDGE)..end[axis].div_ceil(BRICK_EDGE);
        let mut due = std::mem::take(&mut self.room[0]);
        for k in bricks(2) {
            for j in bricks(1) {
                for i in bricks(0) {
                    let low = [i, j, k].map(|n| n * BRICK_EDGE);
                    if look.share.holds(low) {
                        due.push(Block { low, edge: BRICK_EDGE });
                    }
                }
            }
        }
        self.visit(look, due, found);
    }

    /// Looks at blocks: nothing in one is free, or it is put off, or split, or a covered point.
    ///
    /// Distances come first, a handful at a time, so that the processor waits for them together.
    fn visit(&mut self, look: &Look<'_>, mut blocks: Vec<Block>, found: &mut Vec<Entered>) {
        let mut parts = std::mem::take(&mut self.room[1]);
        while !blocks.is_empty() {
            for handful in blocks.chunks(HANDFUL) {
                let mut distances_m = [0.0; HANDFUL];
                for (distance_m, block) in distances_m.iter_mut().zip(handful) {
                    *distance_m = look.distance(*block);
                }
                for (&block, &distance_m) in handful.iter().zip(&distances_m) {
                    self.sort(look, block, distance_m, &mut parts, found);
                }
            }
            std::mem::swap(&mut blocks, &mut parts);
            parts.clear();
        }
        self.room = [blocks, parts];
    }

    /// Decides on a block from φ at its middle; `parts` gets those of one to look at more closely.
    fn sort(
        &mut self,
        look: &Look<'_>,
        block: Block,
        distance_m: f64,
        parts: &mut Vec<Block>,
        found: &mut Vec<Entered>,
    ) {
        let Block { low, edge } = block;
        let free_m = (distance_m - look.reach_m) / LIPSCHITZ - look.radius_m(block);
        if free_m > 0.0 || (edge == 1 && distance_m >= look.reach_m) {
            return self.put_off(block, free_m);
        }
        if look.taken.holds_cube(low, edge) {
            return;
        }
        if edge == 1 {
            return found.push(Entered { place: low, link: look.link, distance_m });
        }
        let followed = look.chosen.map(|chosen| chosen.of_brick(low));
        let edge = edge / 2;
        for octant in 0..8 {
            let step = [octant & 1, octant >> 1 & 1, octant >> 2].map(|bit| bit * edge);
            let low = [low[0] + step[0], low[1] + step[1], low[2] + step[2]];
            match followed.map(|followed| followed.of_cube(low, edge)) {
                Some(few) if few.count() <= FEW => {
                    let free = few.places(low).filter(|place| look.may_enter(*place));
                    parts.extend(free.map(|low| Block { low, edge: 1 }));
                }
                _ if look.is_inside(low) => parts.push(Block { low, edge }),
                _ => {}
            }
        }
    }

    /// Puts a block that the link cannot reach in less than `free_m` on the agenda.
    fn put_off(&mut self, block: Block, free_m: f64) {
        let travel_m = self.travel_m + free_m;
        if let Some(page) = self.pages.get_mut((travel_m / PAGE_M) as usize) {
            page.push(Due { travel_m, block });
        }
    }
}

impl Look<'_> {
    /// Whether a place is one of the lattice's.
    fn is_inside(&self, place: [u32; 3]) -> bool {
        let shape = self.lattice.shape();
        (0..3).all(|axis| place[axis] < shape[axis])
    }

    /// Whether a place is one that a link may come to cover.
    fn may_enter(&self, place: [u32; 3]) -> bool {
        self.is_inside(place) && !self.taken.contains(place)
    }

    /// φ at the middle of a block; of one that is beyond the horizon, no more than φ.
    ///
    /// Most blocks of a new agenda are, and the box of the surface says so of most of these: it is at
    /// hand, where the baked distances of a place that nobody asked about are not.
    fn distance(&self, block: Block) -> f64 {
        let half_m = f64::from(block.edge - 1) / 2.0 * self.lattice.spacing_m();
        let middle = self.lattice.point_at(block.low) + Vector3::repeat(half_m);
        let from_origin = middle.coords - self.pose.translation.vector;
        let middle_link = Point3::from(self.rotation.matrix().tr_mul(&from_origin));
        let beyond_m = self.reach_m + LIPSCHITZ * (HORIZON_M + self.radius_m(block));
        let box_m = self.box_distance_m(&middle_link);
        if box_m > beyond_m { box_m } else { self.surface.distance(&middle_link) }
    }

    /// How far a point is from the box of the link's surface, in the link's frame, m.
    fn box_distance_m(&self, point_link: &Point3<f64>) -> f64 {
        let (low, high) = self.surface.bounds();
        let outside = (low - point_link).sup(&(point_link - high)).sup(&Vector3::zeros());
        outside.norm()
    }

    /// The farthest that a point of a block is from its middle.
    fn radius_m(&self, block: Block) -> f64 {
        f64::from(block.edge - 1) / 2.0 * self.lattice.spacing_m() * 3f64.sqrt()
    }

    /// The places that the link's box reaches within a horizon.
    fn places_near(&self) -> ([u32; 3], [u32; 3]) {
        let mut low = Point3::from(Vector3::repeat(f64::INFINITY));
        let mut high = Point3::from(Vector3::repeat(f64::NEG_INFINITY));
        for corner in corners(self.surface) {
            let corner = self.pose * corner;
            low = low.inf(&corner);
            high = high.sup(&corner);
        }
        let reach = Vector3::repeat(self.reach_m + LIPSCHITZ * HORIZON_M);
        self.lattice.places_within(&(low - reach), &(high + reach))
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
