//! The arm for drawings: the convex hull of every link.
//!
//! A hull is that of the points of the link's baked surface that are outermost in evenly spread
//! directions, which needs a thousandth of the bytes. It is only drawn, and never used for
//! contacts.

use nalgebra::{Isometry3, Point3, Vector3};
use palpate::unstable::DistanceGrid;
use palpate::{Arm, RobotError};
use palpate_view::view_model::LinkShape;
use parry3d_f64::math::Vector as ParryVector;
use parry3d_f64::transformation::try_convex_hull;

/// Largest number of vertices of a link's hull.
const VERTICES: usize = 150;

/// The hulls of the links of an arm that have a surface.
pub(crate) struct Hulls {
    pub(crate) hulls: Vec<LinkShape>,
    /// For each hull, the number of its link in the robot.
    moved: Vec<usize>,
}

impl Hulls {
    /// The hulls of an arm.
    pub(crate) fn of(arm: &Arm) -> Self {
        let surfaces = arm.robot.links().iter().zip(arm.surfaces.iter()).enumerate();
        let (moved, hulls): (Vec<usize>, Vec<LinkShape>) = surfaces
            .filter_map(|(at, (link, surface))| Some((at, hull(&link.name, surface.as_ref()?)?)))
            .unzip();
        Self { hulls, moved }
    }

    /// `world_from_link` of each hull at a joint vector of the same arm.
    ///
    /// # Errors
    ///
    /// If the joint vector does not fit the arm.
    pub(crate) fn poses(&self, arm: &Arm, q: &[f64]) -> Result<Vec<Isometry3<f64>>, RobotError> {
        let poses = arm.robot.forward(q)?;
        Ok(self.moved.iter().map(|&link| poses.world_from_link[link]).collect())
    }
}

/// A link's convex hull; a link thinner than a cell is drawn as its box.
fn hull(link: &str, surface: &DistanceGrid) -> Option<LinkShape> {
    let outermost = outermost(&surface.surface_points());
    let hull = try_convex_hull(&outermost).or_else(|_| try_convex_hull(&corners(surface)));
    let (vertices, triangles) = hull.ok()?;
    let vertices_m = vertices.iter().map(|v| Point3::new(v.x, v.y, v.z)).collect();
    Some(LinkShape { name: link.to_owned(), vertices_m, triangles })
}

/// The points that are farthest in any of the directions of a Fibonacci sphere, each point once.
fn outermost(points: &[Point3<f64>]) -> Vec<ParryVector> {
    let turn = std::f64::consts::PI * (3.0 - 5_f64.sqrt());
    let direction = |n: usize| {
        let z = 1.0 - (2 * n + 1) as f64 / VERTICES as f64;
        let (radius, angle) = ((1.0 - z * z).sqrt(), turn * n as f64);
        Vector3::new(radius * angle.cos(), radius * angle.sin(), z)
    };
    let mut chosen: Vec<usize> = (0..VERTICES)
        .filter_map(|n| {
            let along = |at: &usize| points[*at].coords.dot(&direction(n));
            (0..points.len()).max_by(|a, b| along(a).total_cmp(&along(b)))
        })
        .collect();
    chosen.sort_unstable();
    chosen.dedup();
    chosen.iter().map(|&at| ParryVector::new(points[at].x, points[at].y, points[at].z)).collect()
}

/// The corners of the box around a link.
fn corners(surface: &DistanceGrid) -> Vec<ParryVector> {
    let (low, high) = surface.bounds();
    let of = |corner: usize, axis: usize| [low, high][corner >> axis & 1][axis];
    (0..8).map(|corner| ParryVector::new(of(corner, 0), of(corner, 1), of(corner, 2))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example;

    #[test]
    fn a_hull_is_closed_small_and_fills_its_link() {
        let hulls = Hulls::of(&example::arm()).hulls;
        assert_eq!(hulls.len(), 2);
        for hull in &hulls {
            assert!(hull.vertices_m.len() <= VERTICES);
            // Euler: a closed surface without holes has 2 V − 4 triangles.
            assert_eq!(hull.triangles.len(), 2 * hull.vertices_m.len() - 4);
            let volume: f64 = (hull.triangles.iter())
                .map(|corners| corners.map(|at| hull.vertices_m[at as usize].coords))
                .map(|[a, b, c]| a.dot(&b.cross(&c)) / 6.0)
                .sum();
            let rod = std::f64::consts::PI * 0.03_f64.powi(2) * 0.2;
            assert!((0.85..1.02).contains(&(volume / rod)), "{}: {}", hull.name, volume / rod);
        }
    }
}
