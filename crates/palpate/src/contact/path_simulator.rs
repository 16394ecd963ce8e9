//! The scheduler for a known trajectory: selected points, each followed independently of the others.
//!
//! For every pair of a point and a link, the next waypoint where the link is near the point is known, and φ is looked
//! up only there. The rules are then applied as in [`super::simulator`], in the same order. Each point gets the same
//! contacts as in the step-by-step scheduler, to the bit; a test checks this.
//!
//! If every point of the lattice is needed and every sample is a stop, as in `evaluate`, `tune` and `predict`, the
//! step-by-step scheduler is faster: following all points of `plant_a` with this one took 1.6 to 2.4 times as long
//! (simulated touches, lattices of 1 and 2 cm). This scheduler is for planned paths, where a few points represent many,
//! stops are far apart, and threads share the points.

use nalgebra::{Point3, Vector3};

use super::posed_trajectory::{NearBrick, PosedTrajectory};
use super::rules::{HeldPoint, deepest_first};
use crate::lattice::CellId;
use crate::robot::LinkId;

/// A point that is displaced at a stop.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Displaced {
    /// Its index among the points of the simulator.
    pub(crate) index: usize,
    /// The link that holds it.
    pub(crate) link: LinkId,
    /// u, world frame, m: see [`crate::contact`].
    pub(crate) displacement_m: Vector3<f64>,
}

/// Points that are followed together along a trajectory.
#[derive(Debug)]
pub(crate) struct PathContactSimulator<'a> {
    trajectory: &'a PosedTrajectory,
    points: Vec<Point>,
    /// Pairs of the same point are adjacent.
    pairs: Vec<Pair>,
    /// The waypoint where the link of a pair may next cover its point, by pair; [`NEVER`] if it does
    /// not, or if the point is held.
    next: Vec<u32>,
    /// Held points, by link of the trajectory.
    held: Vec<HeldByLink>,
    /// Pairs by the waypoint where they are due; some may have been deferred since.
    due: Vec<Vec<usize>>,
}

/// No waypoint.
const NEVER: u32 = u32::MAX;

/// A point that is followed.
#[derive(Debug)]
struct Point {
    cell: CellId,
    rest: Point3<f64>,
    /// Index of its first pair.
    pairs: usize,
}

/// A point and a link that comes near it.
#[derive(Debug)]
struct Pair {
    point: usize,
    /// Index among the links of the trajectory.
    link: usize,
    /// The first waypoint where the link may be near.
    from: usize,
}

/// Points held by a link.
#[derive(Debug, Default)]
struct HeldByLink {
    points: Vec<HeldPoint>,
    /// Their indices among the points of the simulator.
    indices: Vec<usize>,
}

/// A free point that a link covers.
struct Covered {
    point: usize,
    distance_m: f64,
    link: usize,
}

impl<'a> PathContactSimulator<'a> {
    /// A simulator without points.
    pub(crate) fn new(trajectory: &'a PosedTrajectory) -> Self {
        let held = trajectory.links.iter().map(|_| HeldByLink::default()).collect();
        let (points, pairs, next) = (Vec::new(), Vec::new(), Vec::new());
        let due = vec![Vec::new(); trajectory.n_waypoints];
        Self { trajectory, points, pairs, next, held, due }
    }

    /// Adds a point that rests at a place of a brick, shifted by `offset_m`. A cell that is held at the first waypoint
    /// keeps its own rest point, without the shift.
    pub(crate) fn add(&mut self, brick: &NearBrick, place: [u32; 3], offset_m: &Vector3<f64>) {
        let lattice = &self.trajectory.lattice;
        let (cell, mut rest) = (lattice.cell(place), lattice.point_at(place) + offset_m);
        let (index, pairs) = (self.points.len(), self.pairs.len());
        let mut is_free = true;
        if let Some(start) = &self.trajectory.start {
            if let Some((link, point)) = start.held(cell) {
                let link = self.trajectory.links.iter().position(|other| other.index == link);
                let held = &mut self.held[link.expect("a link that holds a point has a surface")];
                held.points.push(point);
                held.indices.push(index);
                (rest, is_free) = (lattice.point_at(place), false);
            } else if start.state.taken.contains(place) {
                is_free = false; // known to be empty space
            }
        }
        for &(link, from) in &brick.links {
            self.pairs.push(Pair { point: index, link, from });
            self.next.push(NEVER);
        }
        self.points.push(Point { cell, rest, pairs });
        if is_free {
            self.wait(index, 0);
        }
    }

    /// Rest point of a point, world frame, m.
    pub(crate) fn rest(&self, index: usize) -> &Point3<f64> {
        &self.points[index].rest
    }

    /// Follows all points along the whole trajectory.
    ///
    /// `stop_at` has, by waypoint, the number of the stop there, if there is one: `at_stop` is then called for every
    /// displaced point.
    pub(crate) fn follow(
        mut self,
        stop_at: &[Option<usize>],
        mut at_stop: impl FnMut(usize, &Self, Displaced),
    ) {
        let (mut lists, mut released, mut covered) = Default::default();
        let begins_touch = self.trajectory.start.is_none();
        for (at, stop) in stop_at.iter().enumerate() {
            if at > 0 {
                self.move_held_points(at, &mut lists, &mut released);
            }
            self.find_entered(at, &mut covered);
            let is_empty = at == 0 && begins_touch && self.trajectory.rules.known_empty;
            for Covered { point, link, .. } in covered.drain(..) {
                let pairs = self.pairs_of(point);
                self.next[pairs].fill(NEVER);
                if !is_empty {
                    self.hold(point, link, at);
                }
            }
            let Some(stop) = *stop else { continue };
            for (link, held) in self.trajectory.links.iter().zip(&self.held) {
                for (point, &index) in held.points.iter().zip(&held.indices) {
                    let displacement_m = Vector3::from(point.displacement_m.map(f64::from));
                    let link = LinkId(link.index as u16);
                    at_stop(stop, &self, Displaced { index, link, displacement_m });
                }
            }
        }
    }

    /// Applies stick, slip, rub and release to all points that are held, with the links at a waypoint.
    fn move_held_points(
        &mut self,
        at: usize,
        lists: &mut [Vec<u32>; 2],
        released: &mut Vec<usize>,
    ) {
        for (link, held) in self.trajectory.links.iter().zip(&mut self.held) {
            let surface = self.trajectory.surface(link);
            let points = &mut held.points[..];
            self.trajectory.rules.move_held_points(surface, &link.placed[at], (points, lists));
            let mut index = 0;
            while index < held.points.len() {
                if held.points[index].held {
                    index += 1;
                } else {
                    held.points.swap_remove(index);
                    released.push(held.indices.swap_remove(index));
                }
            }
        }
        // A link may cover them again at the same waypoint.
        for point in released.drain(..) {
            self.wait(point, at);
        }
    }

    /// Finds the free points that enter at a waypoint, each once, at its deepest link.
    fn find_entered(&mut self, at: usize, covered: &mut Vec<Covered>) {
        let mut due = std::mem::take(&mut self.due[at]);
        due.retain(|&pair| self.next[pair] == at as u32);
        due.sort_unstable();
        due.dedup(); // a pair may be deferred to the same waypoint twice
        for pair in due {
            let Pair { point, link: number, .. } = self.pairs[pair];
            let (rest, link) = (self.points[point].rest, &self.trajectory.links[number]);
            let surface = self.trajectory.surface(link);
            let distance_m = surface.distance(&link.placed[at].in_link(&rest));
            if self.trajectory.rules.enters(distance_m) {
                covered.push(Covered { point, distance_m, link: number });
            } else {
                let free_m = distance_m - self.trajectory.rules.contact_distance_m;
                let after = link.after(at, free_m);
                self.defer(pair, after.and_then(|at| link.near(&rest, at)));
            }
        }
        // Pairs of a point are adjacent, with their links in ascending order.
        covered.dedup_by(|later, kept| {
            let depth = |covered: &Covered| (covered.distance_m, covered.link);
            if later.point == kept.point && deepest_first(depth(later), depth(kept)).is_lt() {
                (kept.distance_m, kept.link) = (later.distance_m, later.link);
            }
            later.point == kept.point
        });
    }

    /// Defers all pairs of a free point to the next waypoints, from `at` on, where their links are near.
    fn wait(&mut self, point: usize, at: usize) {
        for pair in self.pairs_of(point) {
            let Pair { link, from, .. } = self.pairs[pair];
            let link = &self.trajectory.links[link];
            self.defer(pair, link.near(&self.points[point].rest, from.max(at)));
        }
    }

    /// Defers a pair to a waypoint, or for ever.
    fn defer(&mut self, pair: usize, to: Option<usize>) {
        self.next[pair] = to.map_or(NEVER, |at| at as u32);
        if let Some(at) = to {
            self.due[at].push(pair);
        }
    }

    /// Anchors a point on the inflated surface of a link.
    fn hold(&mut self, index: usize, link: usize, at: usize) {
        let (point, of_link) = (&self.points[index], &self.trajectory.links[link]);
        let surface = self.trajectory.surface(of_link);
        let (pose, rules) = (&of_link.placed[at].world_from_link, &self.trajectory.rules);
        let held = &mut self.held[link];
        held.points.push(HeldPoint::new(point.cell, point.rest, surface, pose, rules));
        held.indices.push(index);
    }

    fn pairs_of(&self, index: usize) -> std::ops::Range<usize> {
        let end = self.points.get(index + 1).map_or(self.pairs.len(), |next| next.pairs);
        self.points[index].pairs..end
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;
    use std::sync::Arc;

    use nalgebra::{Isometry3, UnitQuaternion};
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    use super::*;
    use crate::contact::{ContactConfig, ContactSimulator};
    use crate::lattice::{BRICK_EDGE, Lattice};
    use crate::robot::{Collision, Shape};
    use crate::sdf::{self, BakeConfig, DistanceGrid, Solid};

    /// Cells with their links and displacements, at a waypoint.
    type Met = HashMap<CellId, (LinkId, [f32; 3])>;

    fn surfaces() -> Arc<Vec<Option<DistanceGrid>>> {
        let shapes = [
            Shape::Cylinder { radius_m: 0.04, length_m: 0.3 },
            Shape::Box { size_m: Vector3::new(0.2, 0.06, 0.1) },
        ];
        let surface = |shape| {
            let collision = Collision { link_from_shape: Isometry3::identity(), shape };
            let solid = Solid { primitives: vec![collision], meshes: vec![] };
            sdf::bake(&solid, &BakeConfig::default()).unwrap().0
        };
        let [cylinder, block] = shapes.map(surface);
        Arc::new(vec![Some(cylinder), None, Some(block)])
    }

    fn lattice() -> Lattice {
        Lattice::new([-0.2; 3], 0.02, [19, 21, 18]).unwrap() // no multiple of a brick
    }

    /// Three links that wander about the lattice, turning every other time.
    fn wander(waypoints: usize) -> Vec<Vec<Isometry3<f64>>> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut uniform = |half: f64| {
            Vector3::from_fn(|_, _| {
                (f64::from(rng.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0) * half
            })
        };
        let mut poses = [0.0, 0.5, 0.15].map(|x| Isometry3::translation(x, 0.0, 0.0));
        let mut speeds = [(Vector3::zeros(), Vector3::zeros()); 3];
        let mut all = vec![poses.to_vec()];
        for motion in 1..waypoints {
            if motion % 25 == 1 {
                let turn = if motion % 50 == 1 { 0.0 } else { 0.03 };
                let back = |pose: &Isometry3<f64>| pose.translation.vector / 50.0;
                speeds = poses.map(|pose| (uniform(0.008) - back(&pose), uniform(turn)));
            }
            for (pose, (along, about)) in poses.iter_mut().zip(&speeds) {
                pose.translation.vector += along;
                pose.rotation = UnitQuaternion::new(*about) * pose.rotation;
            }
            all.push(poses.to_vec());
        }
        all
    }

    /// Contacts of every third cell at every waypoint, by the path simulator.
    fn followed(trajectory: &PosedTrajectory, waypoints: usize) -> Vec<Met> {
        let (lattice, mut path_simulator, mut cells) =
            (lattice(), PathContactSimulator::new(trajectory), Vec::new());
        for brick in trajectory.bricks() {
            let n = BRICK_EDGE;
            for at in 0..n.pow(3) {
                let inside = [at % n, at / n % n, at / (n * n)];
                let place = [0, 1, 2].map(|axis| brick.low[axis] + inside[axis]);
                if lattice.holds(place) && lattice.cell(place).0 % 3 == 0 {
                    path_simulator.add(&brick, place, &Vector3::zeros());
                    cells.push(lattice.cell(place));
                }
            }
        }
        let stops: Vec<_> = (0..waypoints).map(Some).collect();
        let mut met = vec![Met::new(); waypoints];
        path_simulator.follow(
            &stops,
            |stop, path_simulator, Displaced { index, link, displacement_m }| {
                assert_eq!(*path_simulator.rest(index), lattice.point(cells[index]));
                let displacement_m = displacement_m.map(|u| u as f32).into();
                let before = met[stop].insert(cells[index], (link, displacement_m));
                assert!(before.is_none(), "met once");
            },
        );
        met
    }

    /// Contacts of the same cells in the step-by-step simulator.
    fn met_in(simulator: &ContactSimulator) -> Met {
        let links = simulator.contacts().links.into_iter();
        let of_link = links.flat_map(|link| {
            let cells = link.cells.into_iter().zip(link.displacements_m);
            cells.map(move |(cell, displacement_m)| (cell, (link.link, displacement_m)))
        });
        of_link.filter(|(cell, _)| cell.0 % 3 == 0).collect()
    }

    #[test]
    fn both_schedulers_find_the_same_contacts_to_the_bit() {
        let waypoints = wander(800);
        for (known_empty, coulomb_friction) in [(false, 0.0), (true, 0.0), (true, 0.4)] {
            let config =
                ContactConfig { known_empty, coulomb_friction, ..ContactConfig::default() };
            let trajectory = |contact_state, waypoints: &[_]| {
                PosedTrajectory::new(
                    lattice(),
                    surfaces(),
                    &config,
                    false,
                    contact_state,
                    waypoints,
                )
            };
            let mut simulator = ContactSimulator::new(lattice(), surfaces(), &config).unwrap();
            simulator.begin_touch(&waypoints[0]);
            let (mut met, mut contact_state) = (vec![met_in(&simulator)], None);
            for (at, poses) in waypoints.iter().enumerate().skip(1) {
                simulator.advance(poses);
                met.push(met_in(&simulator));
                if at == 300 {
                    contact_state = Some(Arc::new(simulator.state().clone()));
                }
            }
            assert!(followed(&trajectory(None, &waypoints), 800) == met);
            // From the middle of the trajectory, with the contacts held there.
            assert!(followed(&trajectory(contact_state, &waypoints[300..]), 500) == met[300..]);
            let moved = met.windows(2).map(|ends| {
                let left = ends[0].keys().filter(|cell| !ends[1].contains_key(cell)).count();
                [ends[1].len() + left - ends[0].len(), left]
            });
            let [entered, left] = moved.fold([0, 0], |sum, n| [sum[0] + n[0], sum[1] + n[1]]);
            assert!(entered > 500 && left > 300, "{entered} entered, {left} left");
            assert_eq!(met[0].is_empty(), known_empty);
        }
    }

    #[test]
    fn a_point_that_was_pushed_far_away_stays_held() {
        let lattice = Lattice::new([0.0; 3], 0.005, [4, 1, 1]).unwrap();
        let config = ContactConfig { slip_iterations: 0, ..ContactConfig::default() }; // it sticks for good
        let waypoints: Vec<_> = (0..60)
            .map(|n| vec![Isometry3::translation(f64::from(n) * 0.01 - 0.1, 0.0, 0.0)])
            .collect();
        let collision = Collision {
            link_from_shape: Isometry3::identity(),
            shape: Shape::Sphere { radius_m: 0.01 },
        };
        let solid = Solid { primitives: vec![collision], meshes: vec![] };
        let surfaces = Arc::new(vec![Some(sdf::bake(&solid, &BakeConfig::default()).unwrap().0)]);
        let simulator = ContactSimulator::new(lattice.clone(), Arc::clone(&surfaces), &config);
        let mut simulator = simulator.unwrap();
        simulator.begin_touch(&waypoints[0]);
        waypoints[..50].iter().for_each(|poses| drop(simulator.advance(poses)));
        let contact_state = Some(Arc::new(simulator.state().clone()));
        let trajectory = PosedTrajectory::new(
            lattice,
            surfaces,
            &config,
            false,
            contact_state,
            &waypoints[49..],
        );
        let (mut path_simulator, bricks) =
            (PathContactSimulator::new(&trajectory), trajectory.bricks());
        (0..4).for_each(|i| path_simulator.add(&bricks[0], [i, 0, 0], &Vector3::zeros()));
        let mut met = 0;
        path_simulator.follow(&[None, None, Some(0)], |_, _, displaced| {
            assert!(displaced.displacement_m.x > 0.3);
            met += 1;
        });
        assert_eq!(met, 4);
    }

    #[test]
    fn a_link_is_near_where_its_box_is_near_and_nowhere_before() {
        let waypoints = wander(400);
        let trajectory = PosedTrajectory::new(
            lattice(),
            surfaces(),
            &ContactConfig::default(),
            true,
            None,
            &waypoints,
        );
        let reach_m = trajectory.rules.contact_distance_m;
        for link in &trajectory.links {
            for cell in (0..lattice().n_cells() as u32).step_by(37) {
                let point = lattice().point(CellId(cell));
                let (low, high) = trajectory.surface(link).bounds();
                let from_box_m = |at: usize| {
                    let point = link.placed[at].in_link(&point);
                    (low - point).sup(&(point - high)).sup(&Vector3::zeros()).norm()
                };
                let mut from = 0;
                while let Some(at) = link.near(&point, from) {
                    assert!(from_box_m(at) < reach_m + 2e-4);
                    assert!((from..at).all(|between| from_box_m(between) > reach_m));
                    from = at + 1;
                }
                assert!((from..waypoints.len()).all(|at| from_box_m(at) > reach_m));
            }
        }
    }
}
