//! The field and the moving arm, as compact data for a page.

use std::sync::Arc;

use nalgebra::Point3;
use palpate::unstable::{ElasticBody, SegmentKind};
use palpate::{Arm, Field};
use palpate_io::cloud::Cloud;
use palpate_learn::evaluation::{Evaluation, HeldOutTouch};
use palpate_view::view_model::LinkShape;
use palpate_work::elastic::{ArmPath, BentFrames, bend_along};
use serde::Serialize;

use crate::error::CliError;
use crate::extrapolation_view::ExtrapolationView;
use crate::hull::Hulls;
use crate::output::Output;

use super::frames::{drawn, frames_per_touch, stride};
use super::packed::{four_digits, seven, tenths};

/// Largest number of cells shown: the stiffest ones.
const POINTS: usize = 20_000;
/// About the largest number of frames in which an elastic body is shown, in all touches together.
const BODY_FRAMES: usize = 800;
/// Largest number of points shown of a cloud.
const CLOUD_POINTS: usize = 4_000;
/// A segment that starts this close to the end of another is joined to it, m.
const JOINED_M: f64 = 1e-3;

/// The data of the 3-D view, in the number formats of [`super::packed`].
#[derive(Serialize)]
pub(crate) struct Scene {
    /// The stiffest cells in increasing order of stiffness: x, y, z of each.
    points: Vec<i64>,
    /// Stiffness of each, N/m.
    stiffness: Vec<f64>,
    /// Number of touched cells of the field, shown or not.
    cells: usize,
    /// Edge of a cell, m.
    spacing: f64,
    /// The links that have a surface.
    hulls: Vec<Link>,
    /// By touch and drawn frame: for each hull seven numbers, x, y, z, then i, j, k, w of the
    /// quaternion.
    poses: Vec<Vec<Vec<i64>>>,
    /// The elastic body, if there is one.
    body: Option<Body>,
}

/// An elastic body: segments of wood or blocks as lines, leaves as their midpoints.
#[derive(Serialize)]
struct Body {
    /// For each segment of wood, the number of the one at whose end it starts; -1 if `frames` has its start.
    joined_to: Vec<i64>,
    /// `frames` has every n-th drawn frame.
    every: usize,
    /// By touch and frame: for each segment of wood its start, unless it is joined, and its end; then the
    /// midpoints of the leaves.
    frames: Vec<Vec<Vec<i64>>>,
    /// Points of the cloud that the body was made from, thinned evenly: x, y, z of each.
    cloud: Vec<i64>,
    /// Their colours, as CSS has them.
    colours: Vec<String>,
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

    /// Adds the field's elastic body, if it has one, as the arm bends it in every touch, and the cloud that
    /// it was made from.
    ///
    /// # Errors
    ///
    /// If joint positions do not fit the arm, or on Ctrl-C.
    pub(crate) fn bending<'e>(
        mut self,
        (arm, field): (&Arc<Arm>, &Field),
        evaluation: &'e Evaluation,
        cloud: Option<&Cloud>,
        output: &Output,
    ) -> Result<Self, CliError> {
        let Some(model) = &field.elastic else { return Ok(self) };
        let per_touch = frames_per_touch(evaluation);
        let drawn_frames: usize =
            evaluation.touches.iter().map(|touch| drawn(touch.q.len(), per_touch).count()).sum();
        let every = drawn_frames.div_ceil(BODY_FRAMES).max(1);
        let along = |touch: &'e HeldOutTouch| ArmPath {
            q: &touch.q,
            times_s: &touch.time_s,
            every: every * stride(touch.q.len(), per_touch),
        };
        let paths: Vec<ArmPath<'_>> = evaluation.touches.iter().map(along).collect();
        let bent = bend_along(arm, model, &paths, output)?;
        self.body = Some(Body::new(&model.likeliest().body, every, &bent, cloud));
        Ok(self)
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
        // Cells that were never touched have only a prior: they are not shown.
        let mut stiffest: Vec<usize> = field.touched_rows().collect();
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
            body: None,
        })
    }
}

impl Body {
    /// The body as it was bent, by touch and frame.
    fn new(body: &ElasticBody, every: usize, bent: &[BentFrames], cloud: Option<&Cloud>) -> Self {
        let wood: Vec<usize> = (0..body.segments().len())
            .filter(|&at| body.segments()[at].kind != SegmentKind::Leaf)
            .collect();
        let joined_to = |&at: &usize| {
            let segment = &body.segments()[at];
            let parent = segment.parent.map(|parent| parent as usize);
            let parent = parent.filter(|&parent| {
                let apart = segment.start() - Point3::from(body.segments()[parent].end_m);
                apart.norm() < JOINED_M
            });
            parent.and_then(|parent| wood.iter().position(|&at| at == parent))
        };
        let joined_to: Vec<Option<usize>> = wood.iter().map(joined_to).collect();
        let frame = |places: &Vec<[Point3<f64>; 2]>| {
            let mut numbers = Vec::new();
            for (&at, joined_to) in wood.iter().zip(&joined_to) {
                let [start, end] = &places[at];
                numbers.extend(joined_to.is_none().then(|| tenths(start)).into_iter().flatten());
                numbers.extend(tenths(end));
            }
            for (segment, [start, end]) in body.segments().iter().zip(places) {
                if segment.kind == SegmentKind::Leaf {
                    numbers.extend(tenths(&nalgebra::center(start, end)));
                }
            }
            numbers
        };
        let (mut points, mut colours) = (Vec::new(), Vec::new());
        if let Some((cloud, seen)) = cloud.and_then(|cloud| Some((cloud, cloud.colours()?))) {
            let step = cloud.points().len().div_ceil(CLOUD_POINTS).max(1);
            for (point, [r, g, b]) in cloud.points().iter().zip(seen).step_by(step) {
                points.extend(tenths(point));
                colours.push(format!("#{r:02x}{g:02x}{b:02x}"));
            }
        }
        Self {
            joined_to: joined_to.iter().map(|at| at.map_or(-1, |at| at as i64)).collect(),
            every,
            frames: bent.iter().map(|frames| frames.iter().map(frame).collect()).collect(),
            cloud: points,
            colours,
        }
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
