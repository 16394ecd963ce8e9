//! From where a cloud was seen, and through which space the camera looked.

use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};

/// A camera's place and what it saw along each direction.
pub(super) struct View {
    pub viewpoint: Point3<f64>,
    /// Angle between neighbouring pixels, rad.
    pub pixel_rad: f64,
    /// Right, down, forward.
    axes: [Vector3<f64>; 3],
    /// Directions of the seen points, and how far each is, m.
    seen: ImmutableKdTree<f64, 2>,
    distances_m: Vec<f64>,
}

/// Behind the nearest point by less than this, space is not said to be seen, m.
const TOLERANCE_M: f64 = 0.012;

impl View {
    /// A view of points from a place. Points behind it are left out.
    pub(super) fn new(points: &[Point3<f64>], viewpoint: Point3<f64>) -> Self {
        let middle = points.iter().fold(Vector3::zeros(), |sum, point| sum + point.coords)
            / points.len().max(1) as f64;
        let forward = (middle - viewpoint.coords).try_normalize(1e-9).unwrap_or(Vector3::x());
        let up = if forward.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
        let right = forward.cross(&up).normalize();
        let axes = [right, forward.cross(&right), forward];
        let (slopes, distances_m): (Vec<[f64; 2]>, Vec<f64>) =
            points.iter().filter_map(|point| slopes(&axes, &(point - viewpoint))).unzip();
        let seen = ImmutableKdTree::new_from_slice(&slopes);
        Self { viewpoint, pixel_rad: pixel(&seen, &slopes), axes, seen, distances_m }
    }

    /// Share of the way between two places that the camera saw to be empty: what it saw in that
    /// direction, if anything, lies behind.
    pub(super) fn seen_free(&self, from: &Point3<f64>, to: &Point3<f64>) -> f64 {
        const PLACES: u32 = 9;
        let is_free = |step: u32| {
            let share = 0.1 + 0.8 * f64::from(step) / f64::from(PLACES - 1);
            let place = from + (to - from) * share;
            let Some((slopes, distance)) = slopes(&self.axes, &(place - self.viewpoint)) else {
                return false;
            };
            let near = self.seen.nearest_one::<SquaredEuclidean>(&slopes);
            let is_seen = near.distance.sqrt() < 0.75 * self.pixel_rad;
            !is_seen || self.distances_m[near.item as usize] > distance + TOLERANCE_M
        };
        (0..PLACES).filter(|&step| is_free(step)).count() as f64 / f64::from(PLACES)
    }
}

/// Slopes of a ray across and down, and its length; nothing behind the camera.
fn slopes(
    [right, down, forward]: &[Vector3<f64>; 3],
    ray: &Vector3<f64>,
) -> Option<([f64; 2], f64)> {
    let depth = ray.dot(forward);
    (depth > 1e-6).then(|| ([ray.dot(right) / depth, ray.dot(down) / depth], ray.norm()))
}

/// The angle between a seen point and the one next to it, in the median, rad.
fn pixel(seen: &ImmutableKdTree<f64, 2>, slopes: &[[f64; 2]]) -> f64 {
    const TWO: NonZero<usize> = NonZero::<usize>::MIN.saturating_add(1);
    let gap = |slopes: &[f64; 2]| {
        let near = seen.nearest_n::<SquaredEuclidean>(slopes, TWO);
        near.last().map_or(0.0, |near| near.distance.sqrt())
    };
    let mut gaps: Vec<f64> = slopes.iter().step_by(1 + slopes.len() / 2000).map(gap).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.get(gaps.len() / 2).map_or(1e-3, |gap| gap.max(1e-5))
}

/// Where a camera must have stood that saw these points: on the side to which what was seen bulges.
///
/// Only the side of a rod that faces the camera is seen, so that normals of curved pieces, oriented by the
/// sense in which they curve, point to the camera on average. How far it stood cannot be told: two metres.
pub(super) fn guess_viewpoint(points: &[Point3<f64>]) -> Point3<f64> {
    const REACH_M: f64 = 0.008;
    const FEWEST: usize = 12;
    const MOST_PLACES: usize = 4000;
    let places: Vec<[f64; 3]> = points.iter().map(|point| (*point).into()).collect();
    let n = places.len().max(1) as f64;
    let centre = Point3::from(points.iter().map(|point| point.coords).sum::<Vector3<f64>>() / n);
    let tree: ImmutableKdTree<f64, 3> = ImmutableKdTree::new_from_slice(&places);
    let mut bulge = Vector3::zeros();
    for place in places.iter().step_by(places.len().div_ceil(MOST_PLACES)) {
        let near = tree.within_unsorted::<SquaredEuclidean>(place, REACH_M * REACH_M);
        if near.len() < FEWEST {
            continue;
        }
        let near: Vec<Vector3<f64>> =
            near.iter().map(|near| points[near.item as usize].coords).collect();
        let count = near.len() as f64;
        let middle = near.iter().sum::<Vector3<f64>>() / count;
        let spread =
            near.iter().map(|at| (at - middle) * (at - middle).transpose()).sum::<Matrix3<f64>>();
        let eigen = SymmetricEigen::new(spread / count);
        let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
        // Where the middle is higher than the rim, the surface bulges along the normal.
        let height = |at: &Vector3<f64>| (at - middle).dot(&normal);
        let out = |at: &Vector3<f64>| (at - middle).norm_squared() - height(at).powi(2);
        let mean_out = near.iter().map(out).sum::<f64>() / count;
        let falls: f64 =
            near.iter().map(|at| -height(at) * (out(at) - mean_out)).sum::<f64>() / count;
        bulge += normal * falls;
    }
    let towards = bulge.try_normalize(0.0).unwrap_or(-Vector3::x());
    centre + 2.0 * towards
}
