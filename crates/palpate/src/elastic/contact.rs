//! The arm's links against points of the body: non-penetration and Coulomb friction as energies.
//!
//! A point of the body inside a link is pushed out by a stiff spring along the link's normal, and held by a tangential
//! spring at the place on the link where contact began, up to the friction cone. Beyond the cone the tangential force
//! is `μ f_n`, with the normal force of the previous iteration (*lagged*, as in incremental potential contact), so that
//! both forces are gradients of one energy.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use crate::sdf::DistanceGrid;

/// Contact model of an elastic body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ElasticContactConfig {
    /// Coefficient of sliding friction between arm and body.
    pub friction: f64,
    /// Normal stiffness of a contact point, N/m at a stiffness factor of one.
    pub stiffness_n_per_m: f64,
    /// Tangential stiffness of a contact point, relative to the normal stiffness.
    pub tangential_share: f64,
    /// Creep of held points, s: slip speed = this × tangential force × inverse effective mass of the
    /// segment (1/kg). So heavy parts stick and light parts slip; 0 is Coulomb friction.
    pub creep_s: f64,
    /// Speed of the fastest point of the arm in motions without times, m/s.
    pub speed_m_per_s: f64,
}

impl Default for ElasticContactConfig {
    fn default() -> Self {
        Self {
            friction: 0.3,
            stiffness_n_per_m: 500.0,
            tangential_share: 0.5,
            creep_s: 0.0,
            speed_m_per_s: 0.1,
        }
    }
}

/// Place on a link at which a point of the body sticks, and its normal force in the previous iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Anchor {
    /// Index of the link.
    pub link: usize,
    /// The place, in the frame of the link, m.
    pub place_link: Point3<f64>,
    /// Normal force in the previous iteration, N.
    pub pressed_n: f64,
}

/// A link at one pose.
#[derive(Clone, Copy)]
pub(super) struct PlacedLink<'a> {
    pub index: usize,
    pub grid: &'a DistanceGrid,
    pub world_from_link: Isometry3<f64>,
    pub link_from_world: Isometry3<f64>,
}

impl<'a> PlacedLink<'a> {
    pub(super) fn new(
        index: usize,
        grid: &'a DistanceGrid,
        world_from_link: Isometry3<f64>,
    ) -> Self {
        Self { index, grid, world_from_link, link_from_world: world_from_link.inverse() }
    }

    pub(super) fn distance(&self, point: &Point3<f64>) -> f64 {
        self.grid.distance(&(self.link_from_world * point))
    }
}

/// A point of the body inside a link.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pressed {
    /// The link that it is deepest in, as an index into the given links.
    pub link: usize,
    /// Penetration depth, m.
    pub depth_m: f64,
    /// Gradient of the signed distance, pointing out of the link, world frame; nearly a unit vector.
    pub slope: Vector3<f64>,
}

impl Pressed {
    fn normal(&self) -> Vector3<f64> {
        self.slope.try_normalize(1e-9).unwrap_or(Vector3::z())
    }
}

/// The link in which a ball about a point is deepest, if it is in any.
pub(super) fn deepest(
    links: &[PlacedLink<'_>],
    near: &[u16],
    point: &Point3<f64>,
    radius_m: f64,
) -> Option<Pressed> {
    let distance = |&at: &u16| (at, links[at as usize].distance(point));
    let (at, distance_m) = near.iter().map(distance).min_by(|a, b| a.1.total_cmp(&b.1))?;
    // The smoothed surface is less than 2 mm from the trilinear one.
    if distance_m >= radius_m + 0.002 {
        return None;
    }
    let link = &links[at as usize];
    let (distance_m, slope) = link.grid.smooth_distance_and_slope(&(link.link_from_world * point));
    let slope = link.world_from_link.rotation * slope;
    (distance_m < radius_m).then_some(Pressed {
        link: at as usize,
        depth_m: radius_m - distance_m,
        slope,
    })
}

/// Contact energy of a point, J, its gradient, N, and its curvature, N/m, which is positive semidefinite.
pub(super) struct ContactEnergy {
    pub energy: f64,
    pub slope: Vector3<f64>,
    pub curvature: Matrix3<f64>,
}

impl ElasticContactConfig {
    /// Contact energy of a point inside a link, `offset_m` from its anchor, with normal force `pressed_n`, N, in the
    /// previous iteration. The tangential spring is `yields` times softer than without creep.
    pub(super) fn contact_energy(
        &self,
        pressed: &Pressed,
        offset_m: &Vector3<f64>,
        (pressed_n, yields): (f64, f64),
    ) -> ContactEnergy {
        let (k, n) = (self.stiffness_n_per_m, pressed.normal());
        let tangent = Matrix3::identity() - n * n.transpose();
        let mut energy = 0.5 * k * pressed.depth_m * pressed.depth_m;
        let mut slope = -k * pressed.depth_m * pressed.slope;
        let mut curvature = k * pressed.slope * pressed.slope.transpose();

        let slip = tangent * offset_m;
        let kt = k * self.tangential_share / yields;
        let (size, limit) = (slip.norm(), self.friction * pressed_n);
        if kt * size <= limit {
            energy += 0.5 * kt * size * size;
            slope += kt * slip;
            curvature += kt * tangent;
        } else {
            let along = slip / size;
            energy += limit * (size - 0.5 * limit / kt);
            slope += limit * along;
            curvature += limit / size * (tangent - along * along.transpose());
        }
        ContactEnergy { energy, slope, curvature }
    }

    /// Factor by which creep during `time_s` softens the tangential spring of a point, whose segment has this inverse
    /// effective mass, 1/kg (Maxwell's element, by implicit Euler).
    pub(super) fn creep_softening(&self, inverse_mass: f64, time_s: f64) -> f64 {
        let kt = self.stiffness_n_per_m * self.tangential_share;
        1.0 + time_s * self.creep_s * inverse_mass * kt
    }

    /// Largest elastic tangential offset of a point with this normal force, m.
    pub(super) fn longest_slip_m(&self, pressed_n: f64) -> f64 {
        self.friction * pressed_n / (self.stiffness_n_per_m * self.tangential_share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball about a point, pressed against a wall that fills x < 0.
    fn pressed(point: &Vector3<f64>, radius_m: f64) -> Pressed {
        Pressed { link: 0, depth_m: radius_m - point.x, slope: Vector3::x() }
    }

    #[test]
    fn the_slope_is_the_derivative_of_the_energy_sticking_and_slipping() {
        let config = ElasticContactConfig::default();
        let anchor = Vector3::new(0.004, 0.001, -0.002);
        for slip_m in [0.0001, 0.004] {
            let point = anchor + Vector3::new(-0.002, slip_m, 0.5 * slip_m);
            let resist = |at: Vector3<f64>| {
                config.contact_energy(&pressed(&at, 0.005), &(at - anchor), (2.0, 1.5))
            };
            let here = resist(point);
            for axis in 0..3 {
                let nudge = Vector3::ith(axis, 1e-7);
                let rise = resist(point + nudge).energy - resist(point - nudge).energy;
                let slope = here.slope[axis];
                assert!(
                    (rise / 2e-7 - slope).abs() < 1e-5,
                    "axis {axis}: {} and {slope}",
                    rise / 2e-7
                );
            }
            assert!(here.curvature.symmetric_eigenvalues().min() > -1e-9);
        }
    }

    #[test]
    fn friction_is_at_most_its_share_of_the_normal_force() {
        let config = ElasticContactConfig { friction: 0.3, ..ElasticContactConfig::default() };
        for slip_m in [0.001, 0.01, 0.1] {
            let at = Vector3::new(0.0, slip_m, 0.0);
            let force = -config.contact_energy(&pressed(&at, 0.004), &at, (2.0, 1.0)).slope;
            assert!(force.y < 0.0 && force.y.abs() <= 0.3 * 2.0 + 1e-12, "{} N", force.y);
        }
    }
}
