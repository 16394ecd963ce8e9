//! The rules of the contact model, each for one point and one link at its pose (Sec. II).
//!
//! | rule        | here                          | when                                            |
//! |-------------|-------------------------------|-------------------------------------------------|
//! | enter       | [`ContactRules::enters`]      | a free point has φ < δ                          |
//! | deepest     | [`deepest_first`]             | several links cover it: the smallest φ holds it |
//! | known empty | [`ContactRules::known_empty`] | a link covers it at the start of a touch        |
//! | anchor      | [`HeldPoint::new`]            | it enters: the nearest place with φ = δ         |
//! | stick       | [`HeldPoint::stick`]          | the link moves: the anchor moves with it        |
//! | slip        | [`HeldPoint::slip`]           | u leaves the friction cone about the normal     |
//! | rub         | [`HeldPoint::rub`]            | the link moves across the normal                |
//! | release     | [`HeldPoint::pushes`]         | u·n ≤ 0: its spring would have to pull          |
//!
//! φ is the signed distance from the link's surface, n = ∇φ its outward normal, and u the displacement, anchor − rest
//! point. No rule depends on other points, on torques or on stiffness. Two schedulers apply the rules:
//! [`super::simulator`] to one motion after the other, [`super::path_simulator`] along a trajectory that is known from
//! its start to its end.

use std::cmp::Ordering;

use nalgebra::{Isometry3, Point3, Vector3};

use super::ContactConfig;
use super::posed_link::PosedLink;
use crate::lattice::CellId;
use crate::sdf::{DistanceGrid, LANES};

/// Settings of the contact model, and tolerances of its conditions.
#[derive(Debug, Clone)]
pub(super) struct ContactRules {
    /// δ: anchors lie on the surface φ = δ.
    pub(super) contact_distance_m: f64,
    /// Whether points that the links cover at the start of a touch count as empty space for the whole touch: the
    /// object, at rest, cannot be where the arm is without contact.
    pub(super) known_empty: bool,
    /// λ.
    slip_step_m: f64,
    /// μ.
    friction: f64,
    /// Friction force over normal force.
    coulomb_friction: f64,
    slip_iterations: u32,
    /// Excess over the friction cone below which a point does not slip.
    cone_tolerance_m: f64,
    /// Distance from the surface φ = δ below which an anchor counts as on it.
    surface_tolerance_m: f64,
}

/// Excess over the friction cone below which a point does not slip, as a share of δ.
const CONE_TOLERANCE: f64 = 1e-4;

/// Distance from the surface below which no further Newton step is made, m.
const SURFACE_TOLERANCE_M: f64 = 1e-5;

/// Slope of Coulomb friction over tangential motion, relative to the stiffness of the point. A branch bends, but hardly
/// stretches, so friction along it reverses within millimetres. Of 1, 3 and 10, 3 had the smallest errors on three
/// simulated plants (means 0.37, 0.36 and 0.38).
const FRICTION_SLOPE: f64 = 3.0;

/// Factor on both tolerances where one point represents a cluster of neighbours.
const COARSE: f64 = 100.0;

/// Largest number of Newton steps after the first, until an anchor lies on the surface.
const PROJECTIONS: u32 = 3;

/// Order of links that cover the same point, each given as its φ and number: the first one holds it.
pub(super) fn deepest_first(a: (f64, usize), b: (f64, usize)) -> Ordering {
    a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
}

impl ContactRules {
    /// The rules of a contact model.
    pub(super) fn new(config: &ContactConfig) -> Self {
        Self {
            contact_distance_m: config.contact_distance_m,
            known_empty: config.known_empty,
            slip_step_m: config.slip_step_m,
            friction: config.friction,
            coulomb_friction: config.coulomb_friction,
            slip_iterations: config.slip_iterations,
            cone_tolerance_m: CONE_TOLERANCE * config.contact_distance_m,
            surface_tolerance_m: SURFACE_TOLERANCE_M,
        }
    }

    /// The same rules with looser tolerances, for points that each represent a cluster.
    pub(super) fn coarse(config: &ContactConfig) -> Self {
        let exact = Self::new(config);
        Self {
            cone_tolerance_m: COARSE * exact.cone_tolerance_m,
            surface_tolerance_m: COARSE * exact.surface_tolerance_m,
            ..exact
        }
    }

    /// *Enter*: whether a free point at distance φ from the surface of a link enters contact.
    #[inline]
    pub(super) fn enters(&self, distance_m: f64) -> bool {
        distance_m < self.contact_distance_m
    }

    /// *Stick*, *slip*, *rub* and *release* for all points that one link holds, after it has moved.
    ///
    /// Points slip in rounds, all together, so that the processor looks up many distances at once instead of waiting
    /// for each. The two lists are reused memory for the indices of points that still slip, and of those that are still
    /// off the surface. Released points have [`HeldPoint::held`] false afterwards.
    pub(super) fn move_held_points(
        &self,
        surface: &DistanceGrid,
        placed: &PosedLink,
        (points, [slipping, off]): (&mut [HeldPoint], &mut [Vec<u32>; 2]),
    ) {
        if self.coulomb_friction > 0.0 {
            points.iter_mut().for_each(HeldPoint::remember_rest);
        }
        slipping.clear();
        for (index, point) in points.iter_mut().enumerate() {
            point.stick(placed);
            if self.slip_iterations > 0 && point.slip(self) {
                slipping.push(index as u32);
            }
        }
        for round in 1..=self.slip_iterations {
            if slipping.is_empty() {
                break;
            }
            off.clone_from(slipping);
            self.project(surface, points, off);
            if round < self.slip_iterations {
                slipping.retain(|&index| points[index as usize].slip(self));
            }
        }
        points.iter_mut().for_each(|point| point.finish(placed));
        if self.coulomb_friction > 0.0 {
            points.iter_mut().for_each(|point| point.rub(placed, self.coulomb_friction));
        }
    }

    /// [`HeldPoint::project`] for all points `off` the surface, in batches, with the same bits; empties `off`.
    fn project(&self, surface: &DistanceGrid, points: &mut [HeldPoint], off: &mut Vec<u32>) {
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = pulp::x86::V3::try_new() {
            return simd.vectorize(
                #[inline(always)]
                || self.project_batches(surface, points, off),
            );
        }
        self.project_batches(surface, points, off);
    }

    #[inline(always)]
    fn project_batches(
        &self,
        surface: &DistanceGrid,
        points: &mut [HeldPoint],
        off: &mut Vec<u32>,
    ) {
        for _ in 0..=PROJECTIONS {
            let mut still_off = 0;
            for first in (0..off.len()).step_by(LANES) {
                let count = LANES.min(off.len() - first);
                let mut index = [off[first] as usize; LANES]; // the first point fills the free lanes
                let mut anchors = [[0.0; LANES]; 3];
                for lane in 0..LANES {
                    if lane < count {
                        index[lane] = off[first + lane] as usize;
                    }
                    let anchor = &points[index[lane]].anchor_link;
                    anchors[0][lane] = anchor.x;
                    anchors[1][lane] = anchor.y;
                    anchors[2][lane] = anchor.z;
                }
                let (distance_m, normal) = surface.distances_and_normals(&anchors);
                for lane in 0..count {
                    let point = &mut points[index[lane]];
                    let miss_m = distance_m[lane] - self.contact_distance_m;
                    point.normal_link =
                        Vector3::new(normal[0][lane], normal[1][lane], normal[2][lane]);
                    point.anchor_link -= point.normal_link * miss_m;
                    off[still_off] = index[lane] as u32;
                    still_off += usize::from(miss_m.abs() >= self.surface_tolerance_m);
                }
            }
            off.truncate(still_off);
            if off.is_empty() {
                return;
            }
        }
        off.clear();
    }
}

/// A point that a link holds: where it rests, and the anchor on the link.
///
/// Everything happens in the link's frame, where the surface stands still and the rest point moves.
/// A point that sticks costs no look-up of φ: the normal at its anchor is kept.
#[derive(Debug, Clone)]
pub(super) struct HeldPoint {
    pub(super) cell: CellId,
    /// Whether the link still holds it.
    pub(super) held: bool,
    /// The force on the point, divided by its stiffness, world frame, m: u, or with Coulomb friction the
    /// normal part of u and friction.
    pub(super) displacement_m: [f32; 3],
    rest: Point3<f64>,
    rest_link: Point3<f64>,
    /// The anchor, on the surface φ = δ.
    anchor_link: Point3<f64>,
    /// ∇φ at the anchor, a unit vector.
    normal_link: Vector3<f64>,
    /// Coulomb friction divided by the stiffness, m: tangential, at most `coulomb_friction` times u·n.
    friction_link: Vector3<f64>,
}

impl HeldPoint {
    /// A point that enters contact: its anchor is the nearest place with φ = δ.
    pub(super) fn new(
        cell: CellId,
        rest: Point3<f64>,
        surface: &DistanceGrid,
        world_from_link: &Isometry3<f64>,
        rules: &ContactRules,
    ) -> Self {
        let rest_link = world_from_link.inverse_transform_point(&rest);
        let mut point = Self {
            cell,
            held: true,
            displacement_m: [0.0; 3],
            rest,
            rest_link,
            anchor_link: rest_link,
            normal_link: Vector3::zeros(),
            friction_link: Vector3::zeros(),
        };
        point.project(surface, rules);
        let displacement = world_from_link.rotation * (point.anchor_link - rest_link);
        point.displacement_m = displacement.cast::<f32>().into();
        point
    }

    /// *Stick*: the anchor stays where it is on the link, so the rest point moves in its frame.
    fn stick(&mut self, placed: &PosedLink) {
        self.rest_link = placed.in_link(&self.rest);
    }

    /// *Release*: whether the spring of a point pushes, given u·n, the normal part of u. A link releases a point whose
    /// spring would have to pull.
    fn pushes(along_m: f64) -> bool {
        along_m > 0.0
    }

    /// *Slip*: if u violates the friction cone, moves the anchor one tangential step towards the rest point; returns
    /// whether it did. Also updates whether the link still holds the point (*release*).
    ///
    /// The step is the excess of the tangential part of u over μ times its normal part, at most λ.
    fn slip(&mut self, rules: &ContactRules) -> bool {
        let displacement = self.anchor_link - self.rest_link;
        let along_m = displacement.dot(&self.normal_link);
        let across = displacement - self.normal_link * along_m;
        let across_m = across.norm();
        let excess_m = across_m - rules.friction * along_m;
        self.held = Self::pushes(along_m);
        let slips = self.held & (excess_m > rules.cone_tolerance_m);
        // Computed in any case: a mispredicted branch costs more than a division.
        let step = if slips { excess_m.min(rules.slip_step_m) / across_m } else { 0.0 };
        self.anchor_link -= across * step;
        slips
    }

    /// Takes the anchor back to the surface φ = δ by a few Newton steps along ∇φ; where φ is a true distance the first
    /// step is exact.
    fn project(&mut self, surface: &DistanceGrid, rules: &ContactRules) {
        for _ in 0..=PROJECTIONS {
            let (distance_m, normal) = surface.distance_and_normal(&self.anchor_link);
            let miss_m = distance_m - rules.contact_distance_m;
            self.normal_link = normal;
            self.anchor_link -= normal * miss_m;
            if miss_m.abs() < rules.surface_tolerance_m {
                break;
            }
        }
    }

    /// Releases the point if its spring would have to pull, and turns u into the world frame.
    fn finish(&mut self, placed: &PosedLink) {
        let displacement = self.anchor_link - self.rest_link;
        self.held &= Self::pushes(displacement.dot(&self.normal_link));
        self.displacement_m = (placed.rotation * displacement).cast::<f32>().into();
    }

    /// Called before the link moves: adds the rest point, so that [`HeldPoint::rub`] can subtract the one after the
    /// motion.
    fn remember_rest(&mut self) {
        self.friction_link += self.rest_link.coords * FRICTION_SLOPE;
    }

    /// *Rub*: replaces the tangential part of u by Coulomb friction. Friction grows with the tangential motion of the
    /// link, up to `coulomb_friction` times the normal force, so it reverses soon after the motion does.
    fn rub(&mut self, placed: &PosedLink, coulomb_friction: f64) {
        let along_m = (self.anchor_link - self.rest_link).dot(&self.normal_link);
        let mut friction = self.friction_link - self.rest_link.coords * FRICTION_SLOPE;
        friction -= self.normal_link * friction.dot(&self.normal_link);
        let (most_m, friction_m) = (coulomb_friction * along_m.max(0.0), friction.norm());
        if friction_m > most_m {
            friction *= most_m / friction_m;
        }
        self.friction_link = friction;
        let displacement = self.normal_link * along_m + friction;
        self.displacement_m = (placed.rotation * displacement).cast::<f32>().into();
    }
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    use super::*;
    use crate::{Arm, BakeConfig, Robot};

    #[test]
    fn points_are_projected_in_batches_as_one_by_one_to_the_bit() {
        let ball = "<collision><geometry><sphere radius='0.05'/></geometry></collision>";
        let urdf = format!(
            "<robot name='r'><link name='base'/><link name='arm'>{ball}</link><joint name='a' type='continuous'>\
             <parent link='base'/><child link='arm'/></joint></robot>"
        );
        let robot = Robot::from_urdf(&urdf).unwrap();
        let bake = BakeConfig::new(0.005, 0.04);
        let arm = Arm::bake(robot, &bake, |_| unreachable!("no meshes")).unwrap().0;
        let surface = arm.surfaces[1].as_ref().unwrap();
        let rules = ContactRules::new(&ContactConfig::default());
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut uniform = || f64::from(rng.next_u32()) / f64::from(u32::MAX);
        for count in [0, 1, 7, 8, 9, 20] {
            let mut point = |_| {
                let rest = Point3::from([0; 3].map(|_| 0.06 * uniform() - 0.03));
                let pose = Isometry3::identity();
                let mut point = HeldPoint::new(CellId(0), rest, surface, &pose, &rules);
                // From places outside the grid too.
                point.anchor_link = Point3::from([0; 3].map(|_| 0.3 * uniform() - 0.15));
                point
            };
            let mut points: Vec<HeldPoint> = (0..count).map(&mut point).collect();
            let mut expected = points.clone();
            expected.iter_mut().for_each(|point| point.project(surface, &rules));
            // Every point but the first, in another order.
            let mut off: Vec<u32> = (1..count).rev().collect();
            rules.project(surface, &mut points, &mut off);
            assert!(off.is_empty());
            for (found, expected) in points.iter().zip(&expected).skip(1) {
                assert_eq!(found.anchor_link, expected.anchor_link);
                assert_eq!(found.normal_link, expected.normal_link);
            }
        }
    }
}
