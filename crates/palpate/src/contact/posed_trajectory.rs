//! A known trajectory of the arm: the poses at all waypoints, and when a link is near a point.
//!
//! No contact rule depends on two points at once. So along a known trajectory, selected points can be followed
//! independently ([`super::path_simulator`]): a point takes no computation until the waypoint where a link comes near
//! it, and any number of threads can share the points.

use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use rustc_hash::FxHashMap;

use super::broad_phase::{LIPSCHITZ, bricks_within};
use super::posed_link::{PosedLink, box_distance_m, travel_in_link_m};
use super::rules::{ContactRules, HeldPoint};
use super::{ContactConfig, ContactState};
use crate::lattice::{BRICK_EDGE, Bricks, CellId, Lattice};
use crate::sdf::DistanceGrid;

/// Points at most this far, m, beyond the reach of a link are tested against its box, others against its bounding ball.
const WITHIN_M: f64 = 0.05;

/// Upper bound of the errors of a distance by rounding to `f32` and by interpolation of φ, m.
const MARGIN_M: f64 = 1e-4;

/// The links' poses at every waypoint of a trajectory; waypoints are so close that no point passes
/// through a link between two of them.
#[derive(Debug)]
pub(crate) struct PosedTrajectory {
    pub(super) lattice: Lattice,
    pub(super) rules: ContactRules,
    surfaces: Arc<Vec<Option<DistanceGrid>>>,
    /// Links with a surface.
    pub(super) links: Vec<Link>,
    pub(super) n_waypoints: usize,
    /// Contacts at the first waypoint; `None` if a touch begins there.
    pub(super) start: Option<Start>,
}

/// Contacts at the start of the trajectory.
#[derive(Debug)]
pub(super) struct Start {
    pub(super) state: Arc<ContactState>,
    /// For each held cell the link that holds it, and the index of the point among those of the link.
    held: FxHashMap<CellId, (usize, usize)>,
}

/// A link along the trajectory.
#[derive(Debug)]
pub(super) struct Link {
    /// Its number in the robot.
    pub(super) index: usize,
    /// Its poses, by waypoint.
    pub(super) placed: Vec<PosedLink>,
    /// By waypoint, upper bound of the motion in the link's frame, m, of points near the link since the first waypoint.
    travel_m: Vec<f64>,
    /// An index into `travel_m`: see [`marks`].
    marks: Vec<u32>,
    mark_m: f64,
    /// The link's box at all waypoints; the last block is padded with boxes far from all points.
    blocks: Vec<Block>,
    /// Origin of the coordinates in `blocks`: the middle of the lattice, which keeps rounding small.
    origin: Point3<f64>,
    /// δ plus [`MARGIN_M`], m.
    reach_m: f64,
    /// Centre and half size of the box, in the link's frame, m.
    middle: Point3<f64>,
    half_m: Vector3<f64>,
}

/// Number of waypoints that are tested together.
const LANES: usize = 4;

/// A link's box at [`LANES`] waypoints. For each axis of the box: its direction x, y, z in the world, and minus the
/// position of the centre along it, relative to [`Link::origin`], m.
type Block = [[[f32; LANES]; 4]; 3];

/// A brick, and the links that may cover points of it.
#[derive(Debug)]
pub(crate) struct NearBrick {
    /// The brick's first place.
    pub(crate) low: [u32; 3],
    /// Indices of these links in the trajectory, each with the first waypoint where it may cover one.
    pub(super) links: Vec<(usize, usize)>,
}

impl PosedTrajectory {
    /// A trajectory through waypoints with these poses, by waypoint and by link.
    ///
    /// With a contact state the trajectory continues from it, and its first waypoint must be where the state was taken;
    /// without one a touch begins there, as in [`super::ContactSimulator`]. With `coarse`, points slip with looser
    /// tolerances, for points that each represent a cluster.
    ///
    /// # Panics
    ///
    /// If a waypoint has fewer poses than there are surfaces, which is a bug in the caller.
    pub(crate) fn new(
        lattice: Lattice,
        surfaces: Arc<Vec<Option<DistanceGrid>>>,
        config: &ContactConfig,
        coarse: bool,
        state: Option<Arc<ContactState>>,
        waypoints: &[Vec<Isometry3<f64>>],
    ) -> Self {
        let (reach_m, shape) = (config.contact_distance_m + MARGIN_M, lattice.shape());
        let origin = nalgebra::center(&lattice.point_at([0; 3]), &lattice.point_at(shape));
        let of_link = |(index, surface): (usize, &Option<DistanceGrid>)| {
            let poses: Vec<_> = waypoints.iter().map(|poses| poses[index]).collect();
            Some(Link::new(index, surface.as_ref()?, reach_m, origin, &poses))
        };
        let links = surfaces.iter().enumerate().filter_map(of_link).collect();
        let rules = if coarse { ContactRules::coarse(config) } else { ContactRules::new(config) };
        let (n_waypoints, start) = (waypoints.len(), state.map(Start::new));
        Self { lattice, rules, surfaces, links, n_waypoints, start }
    }

    /// The bricks where a point can be displaced, in the lattice's order.
    pub(crate) fn bricks(&self) -> Vec<NearBrick> {
        let mut bricks: FxHashMap<[u32; 3], Vec<(usize, usize)>> = FxHashMap::default();
        let half_m = f64::from(BRICK_EDGE - 1) / 2.0 * self.lattice.spacing_m();
        for (number, link) in self.links.iter().enumerate() {
            let (low, high) = self.swept(link);
            for low in bricks_within(&self.lattice, &low, &high) {
                let middle = self.lattice.point_at(low) + Vector3::repeat(half_m);
                if let Some(from) = self.first_near(link, &middle, half_m * 3f64.sqrt()) {
                    bricks.entry(low).or_default().push((number, from));
                }
            }
        }
        for cell in self.start.iter().flat_map(|start| start.held.keys()) {
            let (brick, _) = Bricks::<()>::locate(self.lattice.place(*cell));
            bricks.entry(brick.map(|n| n * BRICK_EDGE)).or_default();
        }
        let mut bricks: Vec<NearBrick> =
            bricks.into_iter().map(|(low, links)| NearBrick { low, links }).collect();
        bricks.sort_unstable_by_key(|near| [near.low[2], near.low[1], near.low[0]]);
        bricks
    }

    pub(super) fn surface(&self, link: &Link) -> &DistanceGrid {
        self.surfaces[link.index].as_ref().expect("a link of a trajectory has a surface")
    }

    /// The first waypoint where a link may cover any point of a ball, if there is one.
    ///
    /// Until then the link must travel at least the distance between the ball and its box. The stored travel is valid
    /// only for points near the box; for a ball farther away, the ball around the box is used.
    fn first_near(&self, link: &Link, middle: &Point3<f64>, radius_m: f64) -> Option<usize> {
        let (mut at, reach_m) = (0, link.reach_m);
        loop {
            let middle_link = link.placed[at].in_link(middle);
            let from_center_m = (middle_link - link.middle).norm();
            let from_ball_m = from_center_m - link.half_m.norm() - radius_m;
            let from_box_m = box_distance_m(self.surface(link), &middle_link);
            let free_m = match from_ball_m > reach_m + WITHIN_M {
                true => from_ball_m - reach_m,
                false => (from_box_m - radius_m - reach_m).min(WITHIN_M),
            };
            if free_m <= 0.0 {
                return Some(at);
            }
            at = link.after(at, free_m)?;
        }
    }

    /// The axis-aligned box around a link, inflated by δ, at all waypoints.
    fn swept(&self, link: &Link) -> (Point3<f64>, Point3<f64>) {
        let surface = self.surface(link);
        let reach = Vector3::repeat(self.rules.contact_distance_m);
        let (low, high) = link
            .placed
            .iter()
            .map(|placed| placed.bounds(surface))
            .fold(link.placed[0].bounds(surface), |(low, high), (a, b)| {
                (low.inf(&a), high.sup(&b))
            });
        (low - reach, high + reach)
    }
}

impl Link {
    fn new(
        index: usize,
        surface: &DistanceGrid,
        reach_m: f64,
        origin: Point3<f64>,
        poses: &[Isometry3<f64>],
    ) -> Self {
        let within_m = reach_m + WITHIN_M;
        let travel_m = poses.windows(2).scan(0.0, |sum_m, ends| {
            *sum_m += travel_in_link_m(surface, within_m, &ends[0], &ends[1]);
            Some(*sum_m)
        });
        let travel_m: Vec<f64> = std::iter::once(0.0).chain(travel_m).collect();
        let (marks, mark_m) = marks(&travel_m);
        let placed: Vec<PosedLink> = poses.iter().map(PosedLink::new).collect();
        let (low, high) = surface.bounds();
        let (middle, half_m) = (nalgebra::center(&low, &high), (high - low) / 2.0);
        let mut blocks = vec![[[[0.0; LANES]; 4]; 3]; placed.len().div_ceil(LANES)];
        for (axis, [_, _, _, offset_m]) in blocks.iter_mut().flatten().enumerate() {
            *offset_m = [if axis % 3 == 0 { FAR_M } else { 0.0 }; LANES];
        }
        for (at, placed) in placed.iter().enumerate() {
            for (axis, along) in placed.rotation.matrix().column_iter().enumerate() {
                let offset_m = -along.dot(&(placed.world_from_link * middle - origin));
                for (numbers, n) in blocks[at / LANES][axis].iter_mut().zip(0..) {
                    let number = if n < 3 { along[n] } else { offset_m };
                    numbers[at % LANES] = number as f32;
                }
            }
        }
        Self { index, placed, travel_m, marks, mark_m, blocks, origin, reach_m, middle, half_m }
    }

    /// The first waypoint after `at` where the link may have come `free_m` closer to a point.
    pub(super) fn after(&self, at: usize, free_m: f64) -> Option<usize> {
        let due_m = self.travel_m[at] + free_m / LIPSCHITZ;
        first_due(&self.travel_m, (&self.marks, self.mark_m), at + 1, due_m)
    }

    /// The first waypoint, from `from` on, where a point is within reach of the link's box.
    pub(super) fn near(&self, point: &Point3<f64>, from: usize) -> Option<usize> {
        let (half, point) = (self.half_m.cast::<f32>(), (point - self.origin).cast::<f32>());
        let limit_m2 = self.reach_m.powi(2) as f32;
        let mut at = from;
        loop {
            let block = self.blocks.get(at / LANES)?;
            let from_box_m2: [f32; LANES] = std::array::from_fn(|n| {
                let outside = |axis: usize| {
                    let [x, y, z, offset] = &block[axis];
                    let along = x[n] * point.x + y[n] * point.y + z[n] * point.z + offset[n];
                    let outside = along.abs() - half[axis];
                    if outside > 0.0 { outside } else { 0.0 }
                };
                let [x, y, z] = [outside(0), outside(1), outside(2)];
                x * x + y * y + z * z
            });
            let first = at - at % LANES;
            let is_near = |lane: &usize| from_box_m2[*lane] <= limit_m2;
            if let Some(lane) = (at - first..LANES).find(is_near) {
                return Some(first + lane);
            }
            let last = (first + LANES).min(self.placed.len()) - 1;
            let free_m = f64::from(from_box_m2[last - first]).sqrt() - self.reach_m;
            at = self.after(last, free_m.min(WITHIN_M))?;
        }
    }
}

/// Number of marks for each waypoint.
const MARKS: usize = 4;

/// The first waypoint, from `from` on, where the link has travelled `due_m`, found with the marks.
fn first_due(
    travel_m: &[f64],
    (marks, mark_m): (&[u32], f64),
    from: usize,
    due_m: f64,
) -> Option<usize> {
    let mark = (due_m / mark_m) as usize;
    if mark >= marks.len() {
        return None;
    }
    // Rounding may give a mark beyond `due_m`; the mark before it never is.
    let from = from.max(marks[mark.saturating_sub(1)] as usize);
    let later = travel_m.get(from..)?;
    later.iter().position(|travel_m| *travel_m >= due_m).map(|n| from + n)
}

/// An index into the travel: for every n, the first waypoint where the link has travelled n steps of a fixed length;
/// and that length, m. There are few waypoints between two marks.
fn marks(travel_m: &[f64]) -> (Vec<u32>, f64) {
    let n = MARKS * travel_m.len();
    let mark_m = (travel_m[travel_m.len() - 1] / n as f64).max(f64::MIN_POSITIVE);
    let mut at = 0;
    let mark = |mark: usize| {
        let due_m = mark as f64 * mark_m;
        while at < travel_m.len() && travel_m[at] < due_m {
            at += 1;
        }
        at as u32
    };
    ((0..=n).map(mark).collect(), mark_m)
}

/// Larger than any distance between a point of a lattice and a link, m; its square is finite.
const FAR_M: f32 = 1e15;

impl Start {
    fn new(state: Arc<ContactState>) -> Self {
        let numbered = |(link, points): (usize, &Vec<HeldPoint>)| {
            let numbers = points.iter().enumerate();
            numbers.map(|(number, point)| (point.cell, (link, number))).collect::<Vec<_>>()
        };
        let held = state.held.iter().enumerate().flat_map(numbered).collect();
        Self { state, held }
    }

    /// The link that holds a cell, as its number in the robot, and the held point.
    pub(super) fn held(&self, cell: CellId) -> Option<(usize, HeldPoint)> {
        let &(link, number) = self.held.get(&cell)?;
        Some((link, self.state.held[link][number].clone()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_index_of_travel_finds_the_same_waypoint_as_a_linear_search() {
        let sums = |steps: Vec<f64>| {
            let sums = steps.iter().scan(0.0, |sum, step| {
                *sum += step;
                Some(*sum)
            });
            std::iter::once(0.0).chain(sums).collect::<Vec<f64>>()
        };
        let uneven = (0..150).map(|n| f64::from(n * n % 23) * 3e-4).collect();
        let stands = (0..90).map(|n| if n / 10 % 2 == 0 { 0.0 } else { 0.007 }).collect();
        let ways = [vec![], vec![0.0; 5], vec![0.0125; 80], vec![0.003; 77], uneven, stands];
        for travel_m in ways.map(sums) {
            let (marks, mark_m) = marks(&travel_m);
            let total_m = travel_m[travel_m.len() - 1];
            let exact = travel_m.iter().flat_map(|m| [*m, m.next_up(), m.next_down()]);
            let steady = (0..400).map(|n| f64::from(n) * total_m / 300.0 - 0.01);
            for due_m in exact.chain(steady).chain([f64::INFINITY]) {
                for from in 0..=travel_m.len() {
                    let due = from + travel_m[from..].partition_point(|m| *m < due_m);
                    let due = (due < travel_m.len()).then_some(due);
                    assert_eq!(first_due(&travel_m, (&marks, mark_m), from, due_m), due, "{due_m}");
                }
            }
        }
    }
}
