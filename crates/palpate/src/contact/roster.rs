//! The points that a link may come to cover, one by one, where few are followed.
//!
//! Where a point stands for many ([`super::Chosen`]), a block holds one or two, and to split blocks
//! costs more than to look at the points. So a [`Roster`] has all free points that the link can reach
//! before the next is written. At every motion it asks the box of the link's surface how far away
//! they are, several of them at once; φ is looked up for those inside only, and not before the link
//! has travelled as far as it was from them.

use nalgebra::Point3;

use super::chosen::Chosen;
use super::enter::{Entered, LIPSCHITZ, Look};

/// How far the link may travel before its roster is written anew; what it reaches later is left out.
pub(super) const HORIZON_M: f64 = 0.04;

/// More than the rounding of places to `f32` may take from a distance, m.
const ROUNDING_M: f64 = 1e-5;

/// One link's roster.
#[derive(Debug, Clone, Default)]
pub(super) struct Roster {
    /// The middle of the link's box when the roster was written, world frame.
    origin: Point3<f64>,
    points: Vec<Waiting>,
    /// x, y and z of the points from there, m, along the world's axes.
    from_origin_m: [Vec<f32>; 3],
    /// Room for the squares of their distances from the link's box, m².
    from_box_m2: Vec<f32>,
}

/// A point that waits for the link.
#[derive(Debug, Clone, Copy)]
struct Waiting {
    place: [u32; 3],
    /// The travel before which the link cannot cover it; infinite once it is not free any more.
    due_m: f64,
}

impl Roster {
    /// Writes the roster anew, with every point that the link can reach before the next time, and
    /// adds the free points with φ < δ to `found`.
    pub(super) fn write(&mut self, look: &Look<'_>, chosen: &Chosen, found: &mut Vec<Entered>) {
        self.points.clear();
        let limit_m = look.within_m();
        for low in look.bricks_near().filter(|low| look.is_brick_within(limit_m, *low)) {
            let free = chosen.of_brick(low).without(&look.taken.of_brick(low));
            // The last bricks may reach beyond the lattice.
            let free = free.places(low).filter(|place| look.is_inside(*place));
            free.for_each(|place| self.points.push(Waiting { place, due_m: 0.0 }));
        }
        self.origin = look.pose * look.middle();
        for (axis, from_origin_m) in self.from_origin_m.iter_mut().enumerate() {
            let points = self.points.iter().map(|point| look.lattice.point_at(point.place));
            from_origin_m.clear();
            from_origin_m.extend(points.map(|point| (point[axis] - self.origin[axis]) as f32));
        }
        self.measure(look);
        self.keep_near(limit_m);
        self.check(look, 0.0, found);
    }

    /// Adds the free points with φ < δ that the link has come to cover to `found`.
    pub(super) fn look(&mut self, look: &Look<'_>, travel_m: f64, found: &mut Vec<Entered>) {
        self.measure(look);
        self.check(look, travel_m, found);
    }

    /// Puts a place that has become free on the roster, and adds it to `found` if it is covered.
    pub(super) fn look_at(
        &mut self,
        look: &Look<'_>,
        place: [u32; 3],
        travel_m: f64,
        found: &mut Vec<Entered>,
    ) {
        let point_link = look.in_link(&look.lattice.point_at(place));
        if look.box_distance_m(&point_link) <= look.within_m() {
            let mut point = Waiting { place, due_m: travel_m };
            point.check(look, travel_m, found);
            self.points.push(point);
            let from_origin_m = look.lattice.point_at(place) - self.origin;
            for (all, &one) in self.from_origin_m.iter_mut().zip(&from_origin_m) {
                all.push(one as f32);
            }
        }
    }

    /// Works out how far the points are from the link's box.
    fn measure(&mut self, look: &Look<'_>) {
        let (low, high) = look.surface.bounds();
        let half = ((high - low) / 2.0).cast::<f32>();
        let middle = (look.pose * look.middle() - self.origin).cast::<f32>();
        let axes = look.rotation.matrix().cast::<f32>(); // the link's, by column
        let from_box_m2 = |x: f32, y: f32, z: f32| {
            let [x, y, z] = [x - middle.x, y - middle.y, z - middle.z];
            let outside = |axis: usize| {
                let along = axes[(0, axis)] * x + axes[(1, axis)] * y + axes[(2, axis)] * z;
                let outside = along.abs() - half[axis];
                if outside > 0.0 { outside } else { 0.0 }
            };
            let [x, y, z] = [outside(0), outside(1), outside(2)];
            x * x + y * y + z * z
        };
        let [x, y, z] = &self.from_origin_m;
        let points = x.iter().zip(y).zip(z);
        self.from_box_m2.clear();
        self.from_box_m2.extend(points.map(|((x, y), z)| from_box_m2(*x, *y, *z)));
    }

    /// Keeps the points that are no further from the link's box than that.
    fn keep_near(&mut self, limit_m: f64) {
        let limit_m2 = (limit_m + ROUNDING_M).powi(2) as f32;
        let mut kept = 0;
        for index in 0..self.points.len() {
            self.points[kept] = self.points[index];
            for all in self.from_origin_m.iter_mut().chain([&mut self.from_box_m2]) {
                all[kept] = all[index];
            }
            kept += usize::from(self.from_box_m2[kept] <= limit_m2);
        }
        self.points.truncate(kept);
        for all in self.from_origin_m.iter_mut().chain([&mut self.from_box_m2]) {
            all.truncate(kept);
        }
    }

    /// Looks φ up where the link may be.
    fn check(&mut self, look: &Look<'_>, travel_m: f64, found: &mut Vec<Entered>) {
        let limit_m2 = (look.reach_m + ROUNDING_M).powi(2) as f32;
        for (point, &from_box_m2) in self.points.iter_mut().zip(&self.from_box_m2) {
            if from_box_m2 <= limit_m2 && point.due_m <= travel_m {
                point.check(look, travel_m, found);
            }
        }
    }
}

impl Waiting {
    /// Adds the point to `found` if it is free and φ < δ there, or puts it off.
    fn check(&mut self, look: &Look<'_>, travel_m: f64, found: &mut Vec<Entered>) {
        let point_link = look.in_link(&look.lattice.point_at(self.place));
        let distance_m = look.surface.distance(&point_link);
        if distance_m >= look.reach_m {
            self.due_m = travel_m + (distance_m - look.reach_m) / LIPSCHITZ;
            return;
        }
        self.due_m = f64::INFINITY;
        if !look.taken.contains(self.place) {
            found.push(Entered { place: self.place, link: look.link, distance_m });
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::sync::Arc;

    use nalgebra::{Isometry3, Vector3};
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    use super::*;
    use crate::contact::{Config, Share, Simulator};
    use crate::lattice::{BrickBits, CellId, Lattice};
    use crate::robot::{Collision, Shape};
    use crate::sdf::{self, Grid, Solid};

    fn surface(shape: Shape) -> Option<Grid> {
        let collision = Collision { link_from_shape: Isometry3::identity(), shape };
        let solid = Solid { primitives: vec![collision], meshes: vec![] };
        Some(sdf::bake(&solid, &sdf::Config::default()).unwrap().0)
    }

    #[test]
    fn no_followed_point_that_a_link_covers_is_ever_free_and_no_other_is_touched() {
        let lattice = Lattice::new([-0.2; 3], 0.02, [19, 21, 18]).unwrap();
        let mut chosen = Chosen::default(); // in some bricks all of every third layer are known
        let mut layers = BrickBits::default();
        (0..512).filter(|inside| inside / 64 % 3 == 0).for_each(|inside| layers.insert(inside));
        for brick in [[1, 1, 1], [0, 1, 1], [1, 0, 2], [0, 0, 0]] {
            chosen.choose(brick, &layers, &layers);
        }
        let chosen = Arc::new(chosen);
        let shapes = [
            Shape::Cylinder { radius_m: 0.04, length_m: 0.3 },
            Shape::Box { size_m: Vector3::new(0.2, 0.06, 0.1) },
        ];
        let surfaces = Arc::new(shapes.map(surface).to_vec());
        for share in [Share::WHOLE, Share { part: 1, of: 2 }] {
            let config = Config { known_empty: false, ..Config::default() };
            let reach_m = config.contact_distance_m;
            let whole = Simulator::new(lattice.clone(), Arc::clone(&surfaces), config);
            let mut simulator = whole.unwrap().following(Some(Arc::clone(&chosen)), share);
            let follows = |place| share.holds(place) && chosen.contains(place);
            let followed: Vec<CellId> = (0..lattice.n_cells() as u32).map(CellId).collect();
            let followed: Vec<CellId> =
                followed.into_iter().filter(|cell| follows(lattice.place(*cell))).collect();
            let mut rng = ChaCha8Rng::seed_from_u64(5);
            let mut uniform = |half: f64| {
                Vector3::from_fn(|_, _| {
                    (f64::from(rng.next_u32()) / f64::from(u32::MAX) * 2.0 - 1.0) * half
                })
            };
            let mut poses = [0.0, 0.15].map(|x| Isometry3::translation(x, 0.0, 0.0));
            simulator.begin_touch(&poses);
            let mut speeds = [(); 2].map(|()| (Vector3::zeros(), Vector3::zeros()));
            let (mut entered, mut left, mut last) = (0, 0, HashSet::new());
            for motion in 0..800 {
                if motion % 25 == 0 {
                    // Straight ahead every other time: travel then is no more than it must be.
                    let turn = if motion % 50 == 0 { 0.0 } else { 0.03 };
                    let back = |pose: &Isometry3<f64>| pose.translation.vector / 50.0;
                    speeds = poses.map(|pose| (uniform(0.008) - back(&pose), uniform(turn)));
                }
                for (pose, (along, about)) in poses.iter_mut().zip(&speeds) {
                    pose.translation.vector += along;
                    pose.rotation = nalgebra::UnitQuaternion::new(*about) * pose.rotation;
                }
                let contacts = simulator.advance(&poses);
                let touched: HashSet<CellId> =
                    contacts.links.iter().flat_map(|link| link.cells.iter().copied()).collect();
                assert!(touched.iter().all(|cell| follows(lattice.place(*cell))));
                for cell in &followed {
                    let point = lattice.point(*cell);
                    let covered = surfaces.iter().flatten().zip(&poses).any(|(surface, pose)| {
                        surface.distance(&pose.inverse_transform_point(&point)) < reach_m
                    });
                    assert!(!covered || touched.contains(cell), "motion {motion}: {point}");
                }
                entered += touched.difference(&last).count();
                left += last.difference(&touched).count();
                last = touched;
            }
            assert!(entered > 1000 && left > 700, "{entered} entered, {left} left");
        }
    }
}
