//! The field and the arm that moves before it, small enough to travel in a page.
//!
//! A link is drawn as the convex hull of its baked surface, thinned to the vertices that are
//! outermost in evenly spread directions: round enough for the eye, a thousandth of the bytes.

use nalgebra::{Isometry3, Point3, Vector3};
use palpate::arm::Arm;
use palpate::field::Field;
use palpate::sdf::Grid;
use palpate_learn::evaluation::Evaluation;
use parry3d_f64::math::Vector as ParryVector;
use parry3d_f64::transformation::try_convex_hull;

use crate::error::CliError;

use super::data;

/// The stiffest cells of a field, so many at most.
const POINTS: usize = 20_000;
/// Vertices of a link's hull, at most.
const VERTICES: usize = 150;

/// What the 3-D view shows.
pub(crate) struct Scene {
    /// The stiffest cells, softest first.
    pub(super) points_m: Vec<Point3<f64>>,
    /// K of each, N/m.
    pub(super) stiffness_n_per_m: Vec<f64>,
    /// Touched cells of the field, shown or not.
    pub(super) cells: usize,
    /// Edge of a cell, m.
    pub(super) spacing_m: f64,
    /// The links that have a surface.
    pub(super) hulls: Vec<Hull>,
    /// By touch and drawn frame, `world_from_link` of each hull.
    pub(super) poses: Vec<Vec<Vec<Isometry3<f64>>>>,
}

/// A link as a closed mesh, in its own frame.
pub(super) struct Hull {
    /// The link's name.
    pub link: String,
    pub vertices_m: Vec<Point3<f64>>,
    pub triangles: Vec<[u32; 3]>,
}

impl Scene {
    /// The field, and the arm in the frames of the evaluation that are drawn.
    ///
    /// # Errors
    ///
    /// If the evaluation's joint positions are not those of the arm.
    pub(crate) fn new(arm: &Arm, field: &Field, evaluation: &Evaluation) -> Result<Self, CliError> {
        let surfaces = arm.robot.links().iter().zip(arm.surfaces.iter()).enumerate();
        let (moved, hulls): (Vec<usize>, Vec<Hull>) = surfaces
            .filter_map(|(at, (link, surface))| Some((at, hull(&link.name, surface.as_ref()?)?)))
            .unzip();
        let per_touch = data::frames_per_touch(evaluation);
        let pose = |q: &Vec<f64>| -> Result<Vec<Isometry3<f64>>, CliError> {
            let poses = arm.robot.forward(q).map_err(CliError::file)?;
            Ok(moved.iter().map(|&link| poses.world_from_link[link]).collect())
        };
        let poses = evaluation.touches.iter().map(|touch| {
            data::drawn(touch.q.len(), per_touch).map(|frame| pose(&touch.q[frame])).collect()
        });
        let poses = poses.collect::<Result<_, CliError>>()?;

        let mut stiffest: Vec<usize> = (0..field.cells.len()).collect();
        let stiffness = |&row: &usize| field.stiffness_n_per_m[row];
        stiffest.sort_by(|a, b| stiffness(a).total_cmp(&stiffness(b)));
        let shown = stiffest.split_off(stiffest.len().saturating_sub(POINTS));
        Ok(Self {
            points_m: shown.iter().map(|&row| field.lattice.point(field.cells[row])).collect(),
            stiffness_n_per_m: shown.iter().map(stiffness).collect(),
            cells: field.cells.len(),
            spacing_m: field.lattice.spacing_m(),
            hulls,
            poses,
        })
    }
}

/// A link's convex hull; a link thinner than a cell is drawn as its box.
fn hull(link: &str, surface: &Grid) -> Option<Hull> {
    let outermost = outermost(&surface.surface_points());
    let hull = try_convex_hull(&outermost).or_else(|_| try_convex_hull(&corners(surface)));
    let (vertices, triangles) = hull.ok()?;
    let vertices_m = vertices.iter().map(|v| Point3::new(v.x, v.y, v.z)).collect();
    Some(Hull { link: link.to_owned(), vertices_m, triangles })
}

/// Of each of the directions of a Fibonacci sphere, the point that lies farthest that way.
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
fn corners(surface: &Grid) -> Vec<ParryVector> {
    let (low, high) = surface.bounds();
    let of = |corner: usize, axis: usize| [low, high][corner >> axis & 1][axis];
    (0..8).map(|corner| ParryVector::new(of(corner, 0), of(corner, 1), of(corner, 2))).collect()
}

#[cfg(test)]
mod tests {
    use super::super::example;
    use super::*;

    #[test]
    fn a_hull_is_closed_small_and_fills_its_link() {
        let arm = example::arm();
        let scene = Scene::new(&arm, &example::field(), &example::evaluation()).unwrap();
        assert_eq!(scene.hulls.len(), 2);
        for hull in &scene.hulls {
            assert!(hull.vertices_m.len() <= VERTICES);
            // Euler: a closed surface without holes has 2 V − 4 triangles.
            assert_eq!(hull.triangles.len(), 2 * hull.vertices_m.len() - 4);
            let volume: f64 = (hull.triangles.iter())
                .map(|corners| corners.map(|at| hull.vertices_m[at as usize].coords))
                .map(|[a, b, c]| a.dot(&b.cross(&c)) / 6.0)
                .sum();
            let rod = std::f64::consts::PI * 0.03_f64.powi(2) * 0.2;
            assert!((0.85..1.02).contains(&(volume / rod)), "{}: {}", hull.link, volume / rod);
        }
    }

    #[test]
    fn the_stiffest_points_are_kept_in_order() {
        let scene = Scene::new(&example::arm(), &example::field(), &example::evaluation()).unwrap();
        assert!(scene.stiffness_n_per_m.is_sorted());
        assert_eq!(scene.points_m.len(), scene.cells.min(POINTS));
    }

    #[test]
    fn joint_positions_of_another_arm_are_an_error() {
        let mut evaluation = example::evaluation();
        evaluation.touches[0].q[0].pop();
        assert!(Scene::new(&example::arm(), &example::field(), &evaluation).is_err());
    }
}
