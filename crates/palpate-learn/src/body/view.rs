//! The viewpoint of a cloud, and the space that the camera saw to be free.

use std::num::NonZero;

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use nalgebra::{Point3, Vector3};

use crate::upper_median::upper_median;

/// The viewpoint of a camera, and the distance that it saw in each direction.
pub(super) struct View {
    pub viewpoint: Point3<f64>,
    /// Angle between neighbouring pixels, rad.
    pub pixel_rad: f64,
    /// Axes of the camera: right, down, forward.
    axes: [Vector3<f64>; 3],
    /// Directions (slopes) of the seen points, and their distances, m.
    seen: ImmutableKdTree<f64, 2>,
    distances_m: Vec<f64>,
    /// Lowest and highest slopes of these directions; beyond them, nothing is known to be free.
    window: [[f64; 2]; 2],
}

/// Tolerance of depth comparisons, m: a place is free, and a point hidden, only if the depths differ by more.
const TOLERANCE_M: f64 = 0.012;

impl View {
    /// A view of points from a viewpoint. Points behind the camera are left out.
    pub(super) fn new(points: &[Point3<f64>], viewpoint: Point3<f64>) -> Self {
        let middle = points.iter().fold(Vector3::zeros(), |sum, point| sum + point.coords)
            / points.len().max(1) as f64;
        let axes = camera_axes(&(middle - viewpoint.coords));
        let (slopes, distances_m): (Vec<[f64; 2]>, Vec<f64>) =
            points.iter().filter_map(|point| slopes(&axes, &(point - viewpoint))).unzip();
        let seen = ImmutableKdTree::new_from_slice(&slopes);
        let bound = |of: fn(f64, f64) -> f64, start: f64| {
            [0, 1].map(|axis| slopes.iter().map(|slopes| slopes[axis]).fold(start, of))
        };
        let window = [bound(f64::min, f64::INFINITY), bound(f64::max, f64::NEG_INFINITY)];
        Self { viewpoint, pixel_rad: pixel(&seen, &slopes), axes, seen, distances_m, window }
    }

    /// Whether the camera saw that a place is free: the place is in the window, and the point in this direction, if
    /// any, is farther away.
    fn is_free(&self, place: &Point3<f64>) -> bool {
        let Some((slopes, distance)) = slopes(&self.axes, &(place - self.viewpoint)) else {
            return false;
        };
        let [low, high] = self.window;
        if (0..2).any(|axis| !(low[axis]..=high[axis]).contains(&slopes[axis])) {
            return false;
        }
        let near = self.seen.nearest_one::<SquaredEuclidean>(&slopes);
        let is_seen = near.distance.sqrt() < 0.75 * self.pixel_rad;
        !is_seen || self.distances_m[near.item as usize] > distance + TOLERANCE_M
    }
}

/// The views of all pictures.
pub(super) struct Views {
    pub all: Vec<View>,
    /// Index of the view that saw each point of the wood.
    pub of_wood: Vec<usize>,
}

impl Views {
    /// Share of the line between two places that any camera saw to be free.
    pub(super) fn seen_free(&self, from: &Point3<f64>, to: &Point3<f64>) -> f64 {
        const PLACES: u32 = 9;
        let is_free = |step: u32| {
            let share = 0.1 + 0.8 * f64::from(step) / f64::from(PLACES - 1);
            let place = from + (to - from) * share;
            self.all.iter().any(|view| view.is_free(&place))
        };
        (0..PLACES).filter(|&step| is_free(step)).count() as f64 / f64::from(PLACES)
    }
}

/// Right, down and forward of a camera that looks along a direction.
fn camera_axes(towards: &Vector3<f64>) -> [Vector3<f64>; 3] {
    let forward = towards.try_normalize(1e-9).unwrap_or(Vector3::x());
    let up = if forward.z.abs() < 0.9 { Vector3::z() } else { Vector3::x() };
    let right = forward.cross(&up).normalize();
    [right, forward.cross(&right), forward]
}

/// Slopes of a ray to the right and down, and its length, m; `None` behind the camera.
fn slopes(
    [right, down, forward]: &[Vector3<f64>; 3],
    ray: &Vector3<f64>,
) -> Option<([f64; 2], f64)> {
    let depth = ray.dot(forward);
    (depth > 1e-6).then(|| ([ray.dot(right) / depth, ray.dot(down) / depth], ray.norm()))
}

/// The median angle between a seen point and its nearest neighbour, rad.
fn pixel(seen: &ImmutableKdTree<f64, 2>, slopes: &[[f64; 2]]) -> f64 {
    const TWO: NonZero<usize> = NonZero::<usize>::MIN.saturating_add(1);
    let gap = |slopes: &[f64; 2]| {
        let near = seen.nearest_n::<SquaredEuclidean>(slopes, TWO);
        near.last().map_or(0.0, |near| near.distance.sqrt())
    };
    let mut gaps: Vec<f64> = slopes.iter().step_by(1 + slopes.len() / 2000).map(gap).collect();
    upper_median(&mut gaps).map_or(1e-3, |gap| gap.max(1e-5))
}

/// Guesses the viewpoint of a cloud: the place from which the fewest points are hidden by others.
///
/// Searches over directions and distances, then around the best; points and result in m, in the same
/// frame. For a cloud that was merged from several views the result is not one of their viewpoints: pass
/// each view as a separate picture.
pub fn guess_viewpoint(points: &[Point3<f64>]) -> Point3<f64> {
    const DIRECTIONS: u32 = 200;
    const DISTANCES_M: [f64; 3] = [0.8, 1.2, 2.0];
    const MAX_POINTS: usize = 15_000;
    let points: Vec<Point3<f64>> =
        points.iter().step_by(points.len().div_ceil(MAX_POINTS).max(1)).copied().collect();
    let n = points.len().max(1) as f64;
    let centre = Point3::from(points.iter().map(|point| point.coords).sum::<Vector3<f64>>() / n);
    let size_m = points.iter().map(|point| (point - centre).norm()).fold(0.0, f64::max);
    let hidden = |place: &Point3<f64>| hidden(&points, place, &centre);
    let candidates = DISTANCES_M.iter().flat_map(|distance_m| {
        // Directions spread evenly over the sphere (Fibonacci).
        (0..DIRECTIONS).map(move |number| {
            let z = 1.0 - (2.0 * f64::from(number) + 1.0) / f64::from(DIRECTIONS);
            let (sine, cosine) = (2.399_963_229_728_653 * f64::from(number)).sin_cos();
            let level = (1.0 - z * z).sqrt();
            centre + (distance_m + size_m) * Vector3::new(level * cosine, level * sine, z)
        })
    });
    let scored = candidates.map(|place| (hidden(&place), place));
    let Some(mut best) = scored.min_by_key(|(hidden, _)| *hidden) else { return centre };
    let mut step_m = 0.2;
    while step_m > 0.01 {
        let ways =
            (0..6).map(|way| Vector3::ith(way / 2, if way % 2 == 0 { step_m } else { -step_m }));
        let near = ways.map(|way| best.1 + way).filter(|place| (place - centre).norm() > size_m);
        match near.map(|place| (hidden(&place), place)).min_by_key(|(hidden, _)| *hidden) {
            Some(better) if better.0 < best.0 => best = better,
            _ => step_m *= 0.5,
        }
    }
    best.1
}

/// Number of points that are hidden behind others, seen from a place.
fn hidden(points: &[Point3<f64>], place: &Point3<f64>, centre: &Point3<f64>) -> usize {
    /// Width of the cells in which points hide each other, at the distance of the centre, m.
    const CELL_M: f64 = 0.004;
    let axes = camera_axes(&(centre - place));
    let cell_rad = CELL_M / (centre - place).norm();
    let seen: Vec<([i32; 2], f64)> = (points.iter())
        .filter_map(|point| slopes(&axes, &(point - place)))
        .map(|(slopes, distance_m)| {
            (slopes.map(|slope| (slope / cell_rad).floor() as i32), distance_m)
        })
        .collect();
    let bound =
        |axis: usize, sign: i32| seen.iter().map(|(at, _)| sign * at[axis]).min().unwrap_or(0);
    let low = [bound(0, 1), bound(1, 1)];
    let size = [0, 1].map(|axis| (-bound(axis, -1) - low[axis] + 1) as usize);
    let cell = |at: &[i32; 2]| (at[0] - low[0]) as usize + size[0] * (at[1] - low[1]) as usize;
    if size[0].saturating_mul(size[1]) > 4_000_000 {
        return points.len(); // the place is among the points
    }
    let mut nearest_m = vec![f64::INFINITY; size[0] * size[1]];
    for (at, distance_m) in &seen {
        let nearest = &mut nearest_m[cell(at)];
        *nearest = nearest.min(*distance_m);
    }
    let behind =
        |(at, distance_m): &&([i32; 2], f64)| *distance_m > nearest_m[cell(at)] + TOLERANCE_M;
    points.len() - seen.len() + seen.iter().filter(behind).count()
}
