//! Which free points a link may have reached: the broad phase of the step-by-step scheduler.
//!
//! φ at the centre of a block of cells gives a lower bound of φ in the whole block, so a block stays free until the
//! link has travelled that far. Each block waits with the travel at which the link may reach it. A motion checks only
//! the blocks that are due by now: a block that may hold covered points is split, and parts that are still free wait
//! again. The cost of a motion depends on the area of the link and on how far it moves.

use nalgebra::{Isometry3, Point3, Vector3};

use super::posed_link::{PosedLink, box_distance_m, travel_in_link_m};
use super::rules::ContactRules;
use crate::lattice::{BRICK_EDGE, CellSet, Lattice};
use crate::sdf::DistanceGrid;

/// A free point inside an inflated link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Entered {
    pub(super) place: [u32; 3],
    pub(super) link: usize,
    pub(super) distance_m: f64,
}

/// Largest change of the baked φ between two points, over their distance: with trilinear interpolation, a distance is
/// not exactly 1-Lipschitz.
pub(super) const LIPSCHITZ: f64 = 1.1;

/// One link, and the points of the lattice that it may enter.
pub(super) struct Query<'a> {
    pub(super) lattice: &'a Lattice,
    /// Places that cannot be entered.
    pub(super) taken: &'a CellSet,
    pub(super) rules: &'a ContactRules,
    pub(super) link: usize,
    pub(super) surface: &'a DistanceGrid,
    pub(super) placed: PosedLink,
}

/// Travel of a link after which all blocks near it are collected anew, m.
const HORIZON_M: f64 = 0.02;

/// Largest distance from a link's box at which points are in its broad phase, for contact distance δ, m.
fn within_m(contact_distance_m: f64) -> f64 {
    contact_distance_m + LIPSCHITZ * HORIZON_M
}

/// Range of travel of one page of waiting blocks, m.
const PAGE_M: f64 = 0.001;

/// A cube of cells, at its first place, of 8, 4, 2 or 1 cells a side.
#[derive(Debug, Clone, Copy)]
struct Block {
    low: [u32; 3],
    edge: u32,
}

/// A block and the travel at which it must be checked again.
#[derive(Debug, Clone, Copy)]
struct Due {
    travel_m: f64,
    block: Block,
}

/// Number of blocks whose distances are looked up together.
const BATCH: usize = 8;

/// The blocks of free points about one link, each with the travel at which the link may reach it.
#[derive(Debug, Clone, Default)]
pub(super) struct BroadPhase {
    /// Upper bound of the motion, in the link's frame, of points within reach since the blocks were collected, m.
    travel_m: f64,
    /// Waiting blocks by the travel at which they are due, a page each [`PAGE_M`]; none before they
    /// are collected.
    pages: Vec<Vec<Due>>,
    /// The first page that may hold a block.
    current: usize,
    /// Reused memory for the blocks of a query and their parts.
    room: [Vec<Block>; 2],
}

impl BroadPhase {
    /// Forgets all blocks: the next query collects them anew.
    pub(super) fn clear(&mut self) {
        self.pages.clear();
    }

    /// Adds a motion of the link to its travel, which is valid for points within [`within_m`] of its box.
    pub(super) fn travel(
        &mut self,
        surface: &DistanceGrid,
        contact_distance_m: f64,
        from: &Isometry3<f64>,
        to: &Isometry3<f64>,
    ) {
        self.travel_m += travel_in_link_m(surface, within_m(contact_distance_m), from, to);
    }

    /// Adds to `found` the free points that the link now covers.
    pub(super) fn find(&mut self, query: &Query<'_>, found: &mut Vec<Entered>) {
        if self.pages.is_empty() || self.travel_m >= HORIZON_M {
            return self.collect(query, found);
        }
        let (page, travel_m) = ((self.travel_m / PAGE_M) as usize, self.travel_m);
        let mut due = std::mem::take(&mut self.room[0]);
        for passed in &mut self.pages[self.current..page] {
            due.extend(passed.drain(..).map(|due| due.block));
        }
        due.extend(
            self.pages[page].extract_if(.., |due| due.travel_m <= travel_m).map(|due| due.block),
        );
        self.current = page;
        self.visit(query, due, found);
    }

    /// Checks a place that has become free: it is added to `found` or waits.
    pub(super) fn find_at(&mut self, query: &Query<'_>, place: [u32; 3], found: &mut Vec<Entered>) {
        let mut due = std::mem::take(&mut self.room[0]);
        due.push(Block { low: place, edge: 1 });
        self.visit(query, due, found);
    }

    /// Collects the blocks anew, from every brick that the link can reach within the horizon, and adds to `found` the
    /// free points that it covers.
    fn collect(&mut self, query: &Query<'_>, found: &mut Vec<Entered>) {
        self.pages.resize((HORIZON_M / PAGE_M) as usize + 1, Vec::new());
        self.pages.iter_mut().for_each(Vec::clear);
        (self.travel_m, self.current) = (0.0, 0);
        let mut due = std::mem::take(&mut self.room[0]);
        due.extend(query.bricks_near().map(|low| Block { low, edge: BRICK_EDGE }));
        self.visit(query, due, found);
    }

    /// Checks blocks. Each is dropped without a free point, waits again, is split, or is a covered point.
    ///
    /// Distances are looked up in batches, so that their memory accesses overlap.
    fn visit(&mut self, query: &Query<'_>, mut blocks: Vec<Block>, found: &mut Vec<Entered>) {
        let mut parts = std::mem::take(&mut self.room[1]);
        while !blocks.is_empty() {
            for batch in blocks.chunks(BATCH) {
                let mut distances_m = [0.0; BATCH];
                for (distance_m, block) in distances_m.iter_mut().zip(batch) {
                    *distance_m = block.distance_m(query);
                }
                for (&block, &distance_m) in batch.iter().zip(&distances_m) {
                    self.sort(query, block, distance_m, &mut parts, found);
                }
            }
            std::mem::swap(&mut blocks, &mut parts);
            parts.clear();
        }
        self.room = [blocks, parts];
    }

    /// Handles a block, given φ at its centre; if it must be split, adds its parts to `parts`.
    fn sort(
        &mut self,
        query: &Query<'_>,
        block: Block,
        distance_m: f64,
        parts: &mut Vec<Block>,
        found: &mut Vec<Entered>,
    ) {
        let Block { low, edge } = block;
        let beyond_m = distance_m - query.rules.contact_distance_m;
        let free_m = beyond_m / LIPSCHITZ - block.radius_m(query);
        if free_m > 0.0 || (edge == 1 && !query.rules.enters(distance_m)) {
            return self.wait(block, free_m);
        }
        if query.taken.holds_cube(low, edge) {
            return;
        }
        if edge == 1 {
            return found.push(Entered { place: low, link: query.link, distance_m });
        }
        let edge = edge / 2;
        for octant in 0..8 {
            let step = [octant & 1, octant >> 1 & 1, octant >> 2].map(|bit| bit * edge);
            let low = [low[0] + step[0], low[1] + step[1], low[2] + step[2]];
            if query.lattice.holds(low) {
                parts.push(Block { low, edge });
            }
        }
    }

    /// Stores a block that the link cannot reach before it has travelled `free_m`.
    fn wait(&mut self, block: Block, free_m: f64) {
        let travel_m = self.travel_m + free_m;
        if let Some(page) = self.pages.get_mut((travel_m / PAGE_M) as usize) {
            page.push(Due { travel_m, block });
        }
    }
}

impl Block {
    /// φ at the centre of a block, or a lower bound of it for a block beyond the horizon.
    ///
    /// Most newly collected blocks are beyond the horizon. For most of these the distance from the link's box is
    /// enough, without a look-up of φ, which would miss the cache.
    fn distance_m(self, query: &Query<'_>) -> f64 {
        let half_m = f64::from(self.edge - 1) / 2.0 * query.lattice.spacing_m();
        let middle = query.lattice.point_at(self.low) + Vector3::repeat(half_m);
        let middle_link = query.placed.in_link(&middle);
        let beyond_m = within_m(query.rules.contact_distance_m) + LIPSCHITZ * self.radius_m(query);
        let box_m = box_distance_m(query.surface, &middle_link);
        if box_m > beyond_m { box_m } else { query.surface.distance(&middle_link) }
    }

    /// Largest distance of a point of a block from its centre, m.
    fn radius_m(self, query: &Query<'_>) -> f64 {
        f64::from(self.edge - 1) / 2.0 * query.lattice.spacing_m() * 3f64.sqrt()
    }
}

impl Query<'_> {
    /// First places of the bricks that the link can reach within the horizon.
    fn bricks_near(&self) -> impl Iterator<Item = [u32; 3]> + use<> {
        let (low, high) = self.placed.bounds(self.surface);
        let reach = Vector3::repeat(within_m(self.rules.contact_distance_m));
        bricks_within(self.lattice, &(low - reach), &(high + reach))
    }
}

/// First places of the bricks with points in a box.
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
