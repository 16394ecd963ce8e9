//! The points that one link holds: stick, slip, release (Sec. II).
//!
//! Everything happens in the link's frame, where the surface stands still and the rest points
//! move. A point that sticks costs no look at the surface: the normal at its anchor is kept. Those
//! that slip do so in rounds, all together, so that the processor has many looks at the surface
//! under way at once instead of waiting for each; no point's way depends on another's.

use nalgebra::{Isometry3, Point3, Vector3};

use super::ContactConfig;
use super::placed::Placed;
use crate::lattice::CellId;
use crate::sdf::DistanceGrid;

/// The contact model's lengths, in metres.
#[derive(Debug)]
pub(super) struct Slip {
    /// δ: anchors lie on the surface φ = δ.
    pub(super) contact_distance_m: f64,
    /// λ.
    step_m: f64,
    /// μ.
    friction: f64,
    iterations: u32,
    /// Excess over the friction cone that is not worth another iteration.
    excess_m: f64,
    /// A miss of the surface that is not worth another look at it.
    miss_m: f64,
}

impl Slip {
    pub(super) fn new(config: &ContactConfig) -> Self {
        Self {
            contact_distance_m: config.contact_distance_m,
            step_m: config.slip_step_m,
            friction: config.friction,
            iterations: config.slip_iterations,
            excess_m: TOUCHES_THE_CONE * config.contact_distance_m,
            miss_m: CLOSE_M,
        }
    }

    /// The same for points each of which stands for many: no closer to cone and surface than that
    /// is worth.
    pub(super) fn roughly(config: &ContactConfig) -> Self {
        let exact = Self::new(config);
        Self { excess_m: ROUGHLY * exact.excess_m, miss_m: ROUGHLY * exact.miss_m, ..exact }
    }
}

/// A touched point: where it rests, and where its link holds it.
#[derive(Debug, Clone)]
pub(super) struct Touched {
    pub(super) cell: CellId,
    /// Whether the link still holds it.
    pub(super) held: bool,
    /// anchor − rest point, world frame, m.
    pub(super) displacement_m: [f32; 3],
    rest: Point3<f64>,
    rest_link: Point3<f64>,
    /// On the surface φ = δ.
    anchor_link: Point3<f64>,
    /// ∇φ there, a unit vector.
    normal_link: Vector3<f64>,
}

impl Touched {
    /// A point that its link takes hold of where the surface φ = δ is nearest.
    pub(super) fn new(
        cell: CellId,
        rest: Point3<f64>,
        surface: &DistanceGrid,
        world_from_link: &Isometry3<f64>,
        slip: &Slip,
    ) -> Self {
        let rest_link = world_from_link.inverse_transform_point(&rest);
        let mut touched = Self {
            cell,
            held: true,
            displacement_m: [0.0; 3],
            rest,
            rest_link,
            anchor_link: rest_link,
            normal_link: Vector3::zeros(),
        };
        touched.project(surface, slip);
        let displacement = world_from_link.rotation * (touched.anchor_link - rest_link);
        touched.displacement_m = displacement.cast::<f32>().into();
        touched
    }

    /// Takes the rest point to where it is in the link's frame now; the anchor stays there.
    fn carry(&mut self, placed: &Placed) {
        self.rest_link = placed.in_link(&self.rest);
    }

    /// Looks whether the point still pushes, and moves the anchor one step along the surface
    /// towards the rest point if the friction cone is violated; says whether it did.
    ///
    /// A spring that only pushes has let go once `u·n ≤ 0`. The step is what the tangential part of
    /// `u = anchor − rest` exceeds μ times its normal part by, and at most λ.
    fn slip(&mut self, slip: &Slip) -> bool {
        let displacement = self.anchor_link - self.rest_link;
        let along_m = displacement.dot(&self.normal_link);
        let across = displacement - self.normal_link * along_m;
        let across_m = across.norm();
        let excess_m = across_m - slip.friction * along_m;
        self.held = along_m > 0.0;
        let slips = self.held & (excess_m > slip.excess_m);
        // Computed in any case: a branch that goes either way costs more than a division.
        let step = if slips { excess_m.min(slip.step_m) / across_m } else { 0.0 };
        self.anchor_link -= across * step;
        slips
    }

    /// Takes the anchor to the surface φ = δ, where the gradient of φ leads.
    ///
    /// A few Newton steps: where φ is a true distance the first one arrives.
    fn project(&mut self, surface: &DistanceGrid, slip: &Slip) {
        for _ in 0..=PROJECTIONS {
            let (distance_m, normal) = surface.distance_and_normal(&self.anchor_link);
            let miss_m = distance_m - slip.contact_distance_m;
            self.normal_link = normal;
            self.anchor_link -= normal * miss_m;
            if miss_m.abs() < slip.miss_m {
                break;
            }
        }
    }

    /// Lets go of a point that would have to pull, and turns u to the world.
    fn finish(&mut self, placed: &Placed) {
        let displacement = self.anchor_link - self.rest_link;
        self.held &= displacement.dot(&self.normal_link) > 0.0;
        self.displacement_m = (placed.rotation * displacement).cast::<f32>().into();
    }
}

/// Excess over the friction cone that is not worth another iteration, as a share of δ.
const TOUCHES_THE_CONE: f64 = 1e-4;

/// A miss of the surface that is not worth another look at it, m.
const CLOSE_M: f64 = 1e-5;

/// By how much either may be exceeded where points stand for others.
const ROUGHLY: f64 = 100.0;

/// Looks at the surface after the first, at most, until an anchor is on it.
const PROJECTIONS: u32 = 3;

/// Lets the points of a link slip until the friction cone holds them, and marks those that let go.
///
/// `slipping` is room for the numbers of those that still do.
pub(super) fn stick_and_slip(
    surface: &DistanceGrid,
    placed: &Placed,
    slip: &Slip,
    (touched, slipping): (&mut [Touched], &mut Vec<u32>),
) {
    slipping.clear();
    for (index, point) in touched.iter_mut().enumerate() {
        point.carry(placed);
        if slip.iterations > 0 && point.slip(slip) {
            slipping.push(index as u32);
        }
    }
    for round in 1..=slip.iterations {
        for &index in slipping.iter() {
            touched[index as usize].project(surface, slip);
        }
        if round < slip.iterations {
            slipping.retain(|&index| touched[index as usize].slip(slip));
        }
    }
    touched.iter_mut().for_each(|point| point.finish(placed));
}
