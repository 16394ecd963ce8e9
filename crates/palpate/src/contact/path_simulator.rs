//! Points that are followed along a way known beforehand.
//!
//! For every point and every link that comes near it, it is known where the link will be near next.
//! So a [`PathContactSimulator`] goes from waypoint to waypoint, looks φ up only for points that a link is near
//! to, takes hold of those that it covers, and settles all that are held together. What a point
//! meets is what [`super::ContactSimulator`] finds for it, to the bit.

use nalgebra::{Point3, Vector3};

use super::posed_trajectory::{Near, PosedTrajectory};
use super::stick_slip::{Touched, stick_and_slip};
use crate::lattice::CellId;
use crate::robot::LinkId;

/// A point that is displaced where the arm stops.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Displaced {
    /// Its number in the path_simulator.
    pub(crate) number: usize,
    /// The link that holds it.
    pub(crate) link: LinkId,
    /// u: anchor − rest point, world frame, m.
    pub(crate) displacement_m: Vector3<f64>,
}

/// Points that are followed together.
#[derive(Debug)]
pub(crate) struct PathContactSimulator<'a> {
    trajectory: &'a PosedTrajectory,
    points: Vec<Point>,
    /// A point's are in a row.
    meetings: Vec<Meeting>,
    /// The waypoint where a meeting comes next, by meeting; [`NEVER`] if it does not, or if the
    /// point is held.
    next: Vec<u32>,
    /// By link of the trajectory.
    held: Vec<Held>,
    /// By waypoint, the meetings that come there; some of them have been put off since.
    due: Vec<Vec<usize>>,
}

/// No waypoint.
const NEVER: u32 = u32::MAX;

/// A point of a path_simulator.
#[derive(Debug)]
struct Point {
    cell: CellId,
    rest: Point3<f64>,
    /// Its first meeting.
    meetings: usize,
}

/// A point and a link that comes near it.
#[derive(Debug)]
struct Meeting {
    point: usize,
    /// Among the links of the trajectory.
    link: usize,
    /// The first waypoint where it may be near.
    from: usize,
}

/// What a link holds.
#[derive(Debug, Default)]
struct Held {
    touched: Vec<Touched>,
    /// Their numbers in the path_simulator.
    points: Vec<usize>,
}

/// A free point that a link covers.
struct Covered {
    point: usize,
    distance_m: f64,
    link: usize,
}

impl<'a> PathContactSimulator<'a> {
    /// A path_simulator of nobody.
    pub(crate) fn new(trajectory: &'a PosedTrajectory) -> Self {
        let held = trajectory.links.iter().map(|_| Held::default()).collect();
        let (points, meetings, next) = (Vec::new(), Vec::new(), Vec::new());
        let due = vec![Vec::new(); trajectory.n_waypoints];
        Self { trajectory, points, meetings, next, held, due }
    }

    /// Adds a point of a brick, at a place in the lattice or somewhat aside of it, m. What is held at
    /// the first waypoint is held where its cell is.
    pub(crate) fn add(&mut self, near: &Near, place: [u32; 3], aside_m: &Vector3<f64>) {
        let lattice = &self.trajectory.lattice;
        let (cell, mut rest) = (lattice.cell(place), lattice.point_at(place) + aside_m);
        let (point, meetings) = (self.points.len(), self.meetings.len());
        let mut is_free = true;
        if let Some(start) = &self.trajectory.start {
            if let Some((index, touched)) = start.held(cell) {
                let link = self.trajectory.links.iter().position(|link| link.index == index);
                let held = &mut self.held[link.expect("a link that holds a point has a surface")];
                held.touched.push(touched);
                held.points.push(point);
                (rest, is_free) = (lattice.point_at(place), false);
            } else if start.contact_state.taken.contains(place) {
                is_free = false; // known to be empty space
            }
        }
        for &(link, from) in &near.links {
            self.meetings.push(Meeting { point, link, from });
            self.next.push(NEVER);
        }
        self.points.push(Point { cell, rest, meetings });
        if is_free {
            self.wait(point, 0);
        }
    }

    /// Where a point rests, world frame, m.
    pub(crate) fn rest(&self, number: usize) -> &Point3<f64> {
        &self.points[number].rest
    }

    /// Takes all points along the whole way.
    ///
    /// `stop_at` has the number of a stop for every waypoint that is one: `feel` is told of every
    /// point that is displaced there.
    pub(crate) fn follow(
        mut self,
        stop_at: &[Option<usize>],
        mut feel: impl FnMut(usize, &Self, Displaced),
    ) {
        let (mut slipping, mut released, mut covered) = (Vec::new(), Vec::new(), Vec::new());
        for (at, stop) in stop_at.iter().enumerate() {
            if at > 0 {
                self.stick_and_slip(at, &mut slipping, &mut released);
            }
            self.look(at, &mut covered);
            let is_empty =
                at == 0 && self.trajectory.config.known_empty && self.trajectory.start.is_none();
            for Covered { point, link, .. } in covered.drain(..) {
                let meetings = self.meetings_of(point);
                self.next[meetings].fill(NEVER);
                if !is_empty {
                    self.hold(point, link, at);
                }
            }
            let Some(stop) = *stop else { continue };
            for (link, held) in self.trajectory.links.iter().zip(&self.held) {
                for (touched, &number) in held.touched.iter().zip(&held.points) {
                    let displacement_m = Vector3::from(touched.displacement_m.map(f64::from));
                    let link = LinkId(link.index as u16);
                    feel(stop, &self, Displaced { number, link, displacement_m });
                }
            }
        }
    }

    /// Lets all that is held slip to where its link is at a waypoint, and releases what must be.
    fn stick_and_slip(&mut self, at: usize, slipping: &mut Vec<u32>, released: &mut Vec<usize>) {
        for (link, held) in self.trajectory.links.iter().zip(&mut self.held) {
            let surface = self.trajectory.surface(link);
            let touched = &mut held.touched[..];
            stick_and_slip(surface, &link.placed[at], &self.trajectory.slip, (touched, slipping));
            let mut number = 0;
            while number < held.touched.len() {
                if held.touched[number].held {
                    number += 1;
                } else {
                    held.touched.swap_remove(number);
                    released.push(held.points.swap_remove(number));
                }
            }
        }
        // Any link may cover them at once.
        for point in released.drain(..) {
            self.wait(point, at);
        }
    }

    /// Finds the free points that links cover at a waypoint, each once, with its deepest link.
    fn look(&mut self, at: usize, covered: &mut Vec<Covered>) {
        let mut due = std::mem::take(&mut self.due[at]);
        due.retain(|&meeting| self.next[meeting] == at as u32);
        due.sort_unstable();
        due.dedup(); // those that were put off, and then again to where they were
        for meeting in due {
            let Meeting { point, link: number, .. } = self.meetings[meeting];
            let (rest, link) = (self.points[point].rest, &self.trajectory.links[number]);
            let distance_m =
                self.trajectory.surface(link).distance(&link.placed[at].in_link(&rest));
            let free_m = distance_m - self.trajectory.config.contact_distance_m;
            if free_m < 0.0 {
                covered.push(Covered { point, distance_m, link: number });
            } else {
                let after = link.after(at, free_m);
                self.put_off(meeting, after.and_then(|at| link.near(&rest, at)));
            }
        }
        // Meetings of a point are in a row, and so are their finds: links in their order.
        covered.dedup_by(|later, kept| {
            if later.point == kept.point && later.distance_m < kept.distance_m {
                (kept.distance_m, kept.link) = (later.distance_m, later.link);
            }
            later.point == kept.point
        });
    }

    /// Lets a point that is free wait for its links, from a waypoint on.
    fn wait(&mut self, point: usize, at: usize) {
        for meeting in self.meetings_of(point) {
            let Meeting { link, from, .. } = self.meetings[meeting];
            let link = &self.trajectory.links[link];
            self.put_off(meeting, link.near(&self.points[point].rest, from.max(at)));
        }
    }

    /// Puts a meeting off to a waypoint, or for good.
    fn put_off(&mut self, meeting: usize, to: Option<usize>) {
        self.next[meeting] = to.map_or(NEVER, |at| at as u32);
        if let Some(at) = to {
            self.due[at].push(meeting);
        }
    }

    /// Anchors a point on the inflated surface of a link.
    fn hold(&mut self, number: usize, link: usize, at: usize) {
        let (point, of_link) = (&self.points[number], &self.trajectory.links[link]);
        let (surface, pose) =
            (self.trajectory.surface(of_link), &of_link.placed[at].world_from_link);
        let held = &mut self.held[link];
        held.touched.push(Touched::new(
            point.cell,
            point.rest,
            surface,
            pose,
            &self.trajectory.slip,
        ));
        held.points.push(number);
    }

    fn meetings_of(&self, number: usize) -> std::ops::Range<usize> {
        let end = self.points.get(number + 1).map_or(self.meetings.len(), |next| next.meetings);
        self.points[number].meetings..end
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

    /// What a path_simulator of every third cell meets, at every waypoint.
    fn met_by_a_crowd(trajectory: &PosedTrajectory, waypoints: usize) -> Vec<Met> {
        let (lattice, mut path_simulator, mut cells) =
            (lattice(), PathContactSimulator::new(trajectory), Vec::new());
        for near in trajectory.bricks() {
            let n = BRICK_EDGE;
            for at in 0..n.pow(3) {
                let inside = [at % n, at / n % n, at / (n * n)];
                let place = [0, 1, 2].map(|axis| near.low[axis] + inside[axis]);
                if lattice.holds(place) && lattice.cell(place).0 % 3 == 0 {
                    path_simulator.add(&near, place, &Vector3::zeros());
                    cells.push(lattice.cell(place));
                }
            }
        }
        let stops: Vec<_> = (0..waypoints).map(Some).collect();
        let mut met = vec![Met::new(); waypoints];
        path_simulator.follow(
            &stops,
            |stop, path_simulator, Displaced { number, link, displacement_m }| {
                assert_eq!(*path_simulator.rest(number), lattice.point(cells[number]));
                let displacement_m = displacement_m.map(|u| u as f32).into();
                let before = met[stop].insert(cells[number], (link, displacement_m));
                assert!(before.is_none(), "met once");
            },
        );
        met
    }

    /// What the simulator says that these cells meet where it is.
    fn met_in(simulator: &ContactSimulator) -> Met {
        let links = simulator.contacts().links.into_iter();
        let of_link = links.flat_map(|link| {
            let cells = link.cells.into_iter().zip(link.displacements_m);
            cells.map(move |(cell, displacement_m)| (cell, (link.link, displacement_m)))
        });
        of_link.filter(|(cell, _)| cell.0 % 3 == 0).collect()
    }

    #[test]
    fn a_crowd_meets_what_the_simulator_finds_for_its_points_to_the_bit() {
        let waypoints = wander(800);
        for known_empty in [false, true] {
            let config = ContactConfig { known_empty, ..ContactConfig::default() };
            let trajectory = |contact_state, waypoints: &[_]| {
                PosedTrajectory::new(
                    lattice(),
                    surfaces(),
                    config.clone(),
                    false,
                    contact_state,
                    waypoints,
                )
            };
            let mut simulator =
                ContactSimulator::new(lattice(), surfaces(), config.clone()).unwrap();
            simulator.begin_touch(&waypoints[0]);
            let (mut met, mut contact_state) = (vec![met_in(&simulator)], None);
            for (at, poses) in waypoints.iter().enumerate().skip(1) {
                simulator.advance(poses);
                met.push(met_in(&simulator));
                if at == 300 {
                    contact_state = Some(Arc::new(simulator.contact_state()));
                }
            }
            assert!(met_by_a_crowd(&trajectory(None, &waypoints), 800) == met);
            // From the middle of the way, of which half is known by what is held there.
            assert!(
                met_by_a_crowd(&trajectory(contact_state, &waypoints[300..]), 500) == met[300..]
            );
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
        let simulator =
            ContactSimulator::new(lattice.clone(), Arc::clone(&surfaces), config.clone());
        let mut simulator = simulator.unwrap();
        simulator.begin_touch(&waypoints[0]);
        waypoints[..50].iter().for_each(|poses| drop(simulator.advance(poses)));
        let contact_state = Some(Arc::new(simulator.contact_state()));
        let trajectory =
            PosedTrajectory::new(lattice, surfaces, config, false, contact_state, &waypoints[49..]);
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
    fn a_link_is_near_where_its_box_is_and_nowhere_before() {
        let waypoints = wander(400);
        let trajectory = PosedTrajectory::new(
            lattice(),
            surfaces(),
            ContactConfig::default(),
            true,
            None,
            &waypoints,
        );
        let reach_m = trajectory.config.contact_distance_m;
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
