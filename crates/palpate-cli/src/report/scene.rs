//! The field and the arm that moves before it, small enough to travel in a page.

use nalgebra::{Isometry3, Point3};
use palpate::{Arm, Field};
use palpate_learn::evaluation::Evaluation;

use crate::error::CliError;
use crate::extrapolation_view::ExtrapolationView;
use crate::hull::{Hull, Hulls};

use super::data;

/// The stiffest cells of a field, so many at most.
const POINTS: usize = 20_000;

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

impl Scene {
    /// The field, and the arm in the frames of the evaluation that are drawn.
    ///
    /// # Errors
    ///
    /// If the evaluation's joint positions are not those of the arm.
    pub(crate) fn new(arm: &Arm, field: &Field, evaluation: &Evaluation) -> Result<Self, CliError> {
        let hulls = Hulls::of(arm);
        let per_touch = data::frames_per_touch(evaluation);
        let pose = |q: &Vec<f64>| hulls.poses(arm, q).map_err(CliError::file);
        let poses = evaluation.touches.iter().map(|touch| {
            data::drawn(touch.q.len(), per_touch).map(|frame| pose(&touch.q[frame])).collect()
        });
        let poses = poses.collect::<Result<_, CliError>>()?;
        Ok(Self::with(field, hulls, poses))
    }

    /// The field, and the arm in one frame of each touch.
    ///
    /// # Errors
    ///
    /// If the joint positions are not those of the arm.
    pub(super) fn seen(seen: &ExtrapolationView<'_>) -> Result<Self, CliError> {
        let hulls = Hulls::of(seen.arm);
        let pose = |q: &Vec<f64>| Ok(vec![hulls.poses(seen.arm, q).map_err(CliError::file)?]);
        let poses = seen.touching.iter().map(pose).collect::<Result<_, CliError>>()?;
        Ok(Self::with(seen.field, hulls, poses))
    }

    fn with(field: &Field, hulls: Hulls, poses: Vec<Vec<Vec<Isometry3<f64>>>>) -> Self {
        // Cells that were only expected to be stiff are no finding.
        let mut stiffest: Vec<usize> =
            (0..field.cells.len()).filter(|&row| field.counts[row] > 0).collect();
        let cells = stiffest.len();
        let stiffness = |&row: &usize| field.stiffness_n_per_m[row];
        stiffest.sort_by(|a, b| stiffness(a).total_cmp(&stiffness(b)));
        let shown = stiffest.split_off(cells.saturating_sub(POINTS));
        Self {
            points_m: shown.iter().map(|&row| field.lattice.point(field.cells[row])).collect(),
            stiffness_n_per_m: shown.iter().map(stiffness).collect(),
            cells,
            spacing_m: field.lattice.spacing_m(),
            hulls: hulls.hulls,
            poses,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::example;
    use super::*;

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
