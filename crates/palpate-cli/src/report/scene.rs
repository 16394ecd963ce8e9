//! The field and the arm that moves before it, small enough to travel in a page.

use palpate::{Arm, Field};
use palpate_learn::evaluation::Evaluation;
use palpate_view::view_model::{LinkShape, touched_rows};
use serde::Serialize;

use crate::error::CliError;
use crate::extrapolation_view::ExtrapolationView;
use crate::hull::Hulls;

use super::frames::{drawn, frames_per_touch};
use super::packed::{four_digits, seven, tenths};

/// The stiffest cells of a field, so many at most.
const POINTS: usize = 20_000;

/// What the 3-D view shows, in the numbers of [`super::packed`].
#[derive(Serialize)]
pub(crate) struct Scene {
    /// The stiffest cells, softest first: x, y, z in turn.
    points: Vec<i64>,
    /// K of each, N/m.
    stiffness: Vec<f64>,
    /// Touched cells of the field, shown or not.
    cells: usize,
    /// Edge of a cell, m.
    spacing: f64,
    /// The links that have a surface.
    hulls: Vec<Link>,
    /// By touch and drawn frame; of each hull seven numbers: x, y, z, then i, j, k, w of the
    /// quaternion.
    poses: Vec<Vec<Vec<i64>>>,
}

/// A link's hull.
#[derive(Serialize)]
struct Link {
    vertices: Vec<i64>,
    triangles: Vec<[u32; 3]>,
}

impl Scene {
    /// The field, and the arm in the frames of the evaluation that are drawn.
    ///
    /// # Errors
    ///
    /// If the evaluation's joint positions are not those of the arm.
    pub(crate) fn new(arm: &Arm, field: &Field, evaluation: &Evaluation) -> Result<Self, CliError> {
        let per_touch = frames_per_touch(evaluation);
        let frames = evaluation.touches.iter().map(|touch| {
            drawn(touch.q.len(), per_touch).map(|frame| touch.q[frame].as_slice()).collect()
        });
        Self::with(field, arm, frames)
    }

    /// The field, and the arm in one frame of each touch.
    ///
    /// # Errors
    ///
    /// If the joint positions are not those of the arm.
    pub(crate) fn seen(seen: &ExtrapolationView<'_>) -> Result<Self, CliError> {
        Self::with(seen.field, seen.arm, seen.touching.iter().map(|q| vec![q.as_slice()]))
    }

    /// The field, and the arm in some frames of each touch, given by their joint positions.
    fn with<'q>(
        field: &Field,
        arm: &Arm,
        frames: impl Iterator<Item = Vec<&'q [f64]>>,
    ) -> Result<Self, CliError> {
        let hulls = Hulls::of(arm);
        let pose = |q: &[f64]| -> Result<Vec<i64>, CliError> {
            Ok(hulls.poses(arm, q).map_err(CliError::file)?.iter().flat_map(seven).collect())
        };
        let poses = frames.map(|touch| touch.into_iter().map(pose).collect());
        let poses = poses.collect::<Result<_, CliError>>()?;
        let link = |LinkShape { vertices_m, triangles, .. }| Link {
            vertices: vertices_m.iter().flat_map(tenths).collect(),
            triangles,
        };
        // Cells that were only expected to be stiff are no finding.
        let mut stiffest: Vec<usize> = touched_rows(field).collect();
        let cells = stiffest.len();
        let stiffness = |&row: &usize| field.stiffness_n_per_m[row];
        stiffest.sort_by(|a, b| stiffness(a).total_cmp(&stiffness(b)));
        let shown = stiffest.split_off(cells.saturating_sub(POINTS));
        let points = shown.iter().map(|&row| field.lattice.point(field.cells[row]));
        Ok(Self {
            points: points.flat_map(|point| tenths(&point)).collect(),
            stiffness: shown.iter().map(|row| four_digits(stiffness(row))).collect(),
            cells,
            spacing: field.lattice.spacing_m(),
            hulls: hulls.hulls.into_iter().map(link).collect(),
            poses,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example;

    #[test]
    fn the_stiffest_points_are_kept_in_order() {
        let scene = Scene::new(&example::arm(), &example::field(), &example::evaluation()).unwrap();
        assert!(scene.stiffness.is_sorted());
        assert_eq!(scene.points.len(), 3 * scene.cells.min(POINTS));
        assert_eq!(scene.stiffness.len(), scene.cells.min(POINTS));
    }

    #[test]
    fn joint_positions_of_another_arm_are_an_error() {
        let mut evaluation = example::evaluation();
        evaluation.touches[0].q[0].pop();
        assert!(Scene::new(&example::arm(), &example::field(), &evaluation).is_err());
    }
}
