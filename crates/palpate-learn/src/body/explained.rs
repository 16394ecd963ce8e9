//! Whether a cloud shows a plant: if so, its points are near the stems, branches and leaves that were found.

use nalgebra::Point3;
use palpate::unstable::{ElasticBody, Segment};

/// A segment explains points that are this close to it, m.
const NEAR_M: f64 = 0.005;
/// Most points that are checked.
const POINTS: usize = 4000;

/// Share of the points that lie on no segment of a body, 0 to 1.
///
/// Simulated plants seen from one side have 0 to 0.09. Cushions, on whose surface the search for wood finds
/// some lines, have 0.73 and 0.77.
pub(super) fn unexplained(body: &ElasticBody, points: &[Point3<f64>]) -> f64 {
    let some = points.iter().step_by(points.len().div_ceil(POINTS).max(1));
    let is_off = |point: &&Point3<f64>| {
        body.segments().iter().all(|segment| distance_m(segment, point) > NEAR_M)
    };
    let off = some.clone().filter(is_off).count();
    off as f64 / some.count().max(1) as f64
}

/// Distance of a point from the surface of a segment, m, where a plate counts as a rod of its width.
fn distance_m(segment: &Segment, point: &Point3<f64>) -> f64 {
    let (axis, way) = (segment.axis(), point - segment.start());
    let share = (way.dot(&axis) / axis.norm_squared()).clamp(0.0, 1.0);
    (way - share * axis).norm() - segment.radius_m - segment.half_width().norm()
}
