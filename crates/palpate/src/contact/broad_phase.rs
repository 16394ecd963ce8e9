//! The blocks of points that a link will look at again, and when.
//!
//! φ is a distance: at the centre of a block of cells it bounds φ everywhere in the block, and a
//! block that is far from the link stays free until the link has travelled as far. So an [`BroadPhase`]
//! has blocks, each due when the link may have reached it. A motion looks at what has become due; a
//! block that may hold covered points is split, and whatever is still free goes back on the broad_phase.
//! What a motion costs follows the link's surface and how far it went.

use nalgebra::{Isometry3, Vector3};

use super::enter::{Entered, LIPSCHITZ, Query};
use super::placed::{box_distance_m, travel_in_link_m};
use crate::lattice::BRICK_EDGE;
use crate::sdf::DistanceGrid;

/// How far the link may travel before its broad_phase is written anew; what it reaches later is left
/// out.
const HORIZON_M: f64 = 0.02;

/// The farthest from a link's box that a point may be to be on the broad_phase.
pub(super) fn within_m(reach_m: f64) -> f64 {
    reach_m + LIPSCHITZ * HORIZON_M
}

/// Travel that shares a page of the broad_phase.
const PAGE_M: f64 = 0.001;

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

/// Blocks looked at together.
const HANDFUL: usize = 8;

/// One link's broad_phase.
#[derive(Debug, Clone, Default)]
pub(super) struct BroadPhase {
    /// How far, at most, any point within reach has moved in the link's frame since the broad_phase was
    /// written.
    travel_m: f64,
    /// Blocks by the travel at which they are due, a page each [`PAGE_M`]; none: not written yet.
    pages: Vec<Vec<Due>>,
    /// The first page that may hold anything.
    current: usize,
    /// Room for the blocks of a look and their parts, kept from look to query.
    room: [Vec<Block>; 2],
}

impl BroadPhase {
    /// Forgets everything: the next look is at all that is near.
    pub(super) fn clear(&mut self) {
        self.pages.clear();
    }

    /// Adds a motion of the link to its travel; only points within [`within_m`] of its box are
    /// asked for.
    pub(super) fn travel(
        &mut self,
        surface: &DistanceGrid,
        reach_m: f64,
        from: &Isometry3<f64>,
        to: &Isometry3<f64>,
    ) {
        self.travel_m += travel_in_link_m(surface, within_m(reach_m), from, to);
    }

    /// Adds the free points with φ < δ that the link has come to cover to `found`.
    pub(super) fn look(&mut self, query: &Query<'_>, found: &mut Vec<Entered>) {
        if self.pages.is_empty() || self.travel_m >= HORIZON_M {
            return self.write(query, found);
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

    /// Puts a place that has become free on the broad_phase, or adds it to `found`.
    pub(super) fn look_at(&mut self, query: &Query<'_>, place: [u32; 3], found: &mut Vec<Entered>) {
        let mut due = std::mem::take(&mut self.room[0]);
        due.push(Block { low: place, edge: 1 });
        self.visit(query, due, found);
    }

    /// Writes the broad_phase anew, from every brick that the link can reach before the next time, and
    /// adds the free points with φ < δ to `found`.
    fn write(&mut self, query: &Query<'_>, found: &mut Vec<Entered>) {
        self.pages.resize((HORIZON_M / PAGE_M) as usize + 1, Vec::new());
        self.pages.iter_mut().for_each(Vec::clear);
        (self.travel_m, self.current) = (0.0, 0);
        let mut due = std::mem::take(&mut self.room[0]);
        due.extend(query.bricks_near().map(|low| Block { low, edge: BRICK_EDGE }));
        self.visit(query, due, found);
    }

    /// Looks at blocks: nothing in one is free, or it is put off, or split, or a covered point.
    ///
    /// Distances come first, a handful at a time, so that the processor waits for them together.
    fn visit(&mut self, query: &Query<'_>, mut blocks: Vec<Block>, found: &mut Vec<Entered>) {
        let mut parts = std::mem::take(&mut self.room[1]);
        while !blocks.is_empty() {
            for handful in blocks.chunks(HANDFUL) {
                let mut distances_m = [0.0; HANDFUL];
                for (distance_m, block) in distances_m.iter_mut().zip(handful) {
                    *distance_m = block.distance_m(query);
                }
                for (&block, &distance_m) in handful.iter().zip(&distances_m) {
                    self.sort(query, block, distance_m, &mut parts, found);
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
        query: &Query<'_>,
        block: Block,
        distance_m: f64,
        parts: &mut Vec<Block>,
        found: &mut Vec<Entered>,
    ) {
        let Block { low, edge } = block;
        let free_m = (distance_m - query.reach_m) / LIPSCHITZ - block.radius_m(query);
        if free_m > 0.0 || (edge == 1 && distance_m >= query.reach_m) {
            return self.put_off(block, free_m);
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

    /// Puts a block that the link cannot reach in less than `free_m` on the broad_phase.
    fn put_off(&mut self, block: Block, free_m: f64) {
        let travel_m = self.travel_m + free_m;
        if let Some(page) = self.pages.get_mut((travel_m / PAGE_M) as usize) {
            page.push(Due { travel_m, block });
        }
    }
}

impl Block {
    /// φ at the middle of a block; of one that is beyond the horizon, no more than φ.
    ///
    /// Most blocks of a new broad_phase are, and the box of the surface says so of most of these: it is
    /// at hand, where the baked distances of a place that nobody asked about are not.
    fn distance_m(self, query: &Query<'_>) -> f64 {
        let half_m = f64::from(self.edge - 1) / 2.0 * query.lattice.spacing_m();
        let middle = query.lattice.point_at(self.low) + Vector3::repeat(half_m);
        let middle_link = query.placed.in_link(&middle);
        let beyond_m = within_m(query.reach_m) + LIPSCHITZ * self.radius_m(query);
        let box_m = box_distance_m(query.surface, &middle_link);
        if box_m > beyond_m { box_m } else { query.surface.distance(&middle_link) }
    }

    /// The farthest that a point of a block is from its middle.
    fn radius_m(self, query: &Query<'_>) -> f64 {
        f64::from(self.edge - 1) / 2.0 * query.lattice.spacing_m() * 3f64.sqrt()
    }
}
