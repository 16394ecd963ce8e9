//! One touched point on one link: stick, slip, release (Sec. II).
//!
//! Everything happens in the link's frame, where the surface stands still and the rest point
//! moves. The functions know no lattice and no link numbers.

use nalgebra::{Point3, Vector3};

use super::Config;
use crate::sdf::Grid;

/// The contact model's lengths, in metres.
pub(super) struct Slip {
    /// δ: anchors lie on the surface φ = δ.
    pub(super) contact_distance_m: f64,
    /// λ.
    step_m: f64,
    /// μ.
    friction: f64,
    iterations: u32,
}

impl Slip {
    pub(super) fn new(config: &Config) -> Self {
        Self {
            contact_distance_m: config.contact_distance_m,
            step_m: config.slip_step_m,
            friction: config.friction,
            iterations: config.slip_iterations,
        }
    }
}

/// Lets an anchor slip until the friction cone holds it, or says that it lets go.
///
/// While the tangential part of `u = anchor − rest` exceeds μ times its normal part, the anchor
/// moves along the surface towards the rest point, by at most λ an iteration, and is projected
/// back onto φ = δ. Returns `None` once `u·n ≤ 0`: a spring that only pushes has let go.
pub(super) fn settle(
    surface: &Grid,
    rest_link: &Point3<f64>,
    anchor_link: &Point3<f64>,
    slip: &Slip,
) -> Option<Point3<f64>> {
    let mut anchor = *anchor_link;
    let (_, mut normal) = surface.distance_and_normal(&anchor);
    for _ in 0..slip.iterations {
        let (along, across) = split(&(anchor - rest_link), &normal);
        if along <= 0.0 {
            return None;
        }
        let tangential_m = across.norm();
        let excess_m = tangential_m - slip.friction * along;
        if excess_m <= TOUCHES_THE_CONE * slip.contact_distance_m {
            break;
        }
        anchor -= across * (excess_m.min(slip.step_m) / tangential_m);
        anchor = project(surface, &anchor, slip.contact_distance_m);
        normal = surface.distance_and_normal(&anchor).1;
    }
    let (along, _) = split(&(anchor - rest_link), &normal);
    (along > 0.0).then_some(anchor)
}

/// Excess over the friction cone that is not worth another iteration, as a share of δ.
const TOUCHES_THE_CONE: f64 = 1e-3;

/// The normal part of a displacement, and the tangential rest.
fn split(displacement: &Vector3<f64>, normal: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let along = displacement.dot(normal);
    (along, displacement - normal * along)
}

/// The point of the surface φ = `level_m` that the gradient of φ leads to.
///
/// A few Newton steps: where φ is a true distance the first one arrives.
pub(super) fn project(surface: &Grid, point_link: &Point3<f64>, level_m: f64) -> Point3<f64> {
    let mut point = *point_link;
    for _ in 0..3 {
        let (distance_m, normal) = surface.distance_and_normal(&point);
        let miss_m = distance_m - level_m;
        point -= normal * miss_m;
        if miss_m.abs() < 1e-5 {
            break;
        }
    }
    point
}
