//! Branches as tapering tubes: from the width that the camera saw, then fitted to the seen points ([`fit()`]).

use nalgebra::{Matrix2, Point3, Vector2, Vector3};

use super::fit::fit;
use super::skeleton::{Branch, SkeletonNode};
use super::view::{View, Views};
use crate::upper_median::upper_median;

/// Smallest and largest radius, m.
pub(super) const RADIUS_M: [f64; 2] = [0.0018, 0.018];

/// Axis and radii of a branch.
#[derive(Debug, Clone)]
pub(super) struct Tube {
    /// Places of the branch's nodes on the axis, m; of a carried branch, the first is on the axis of the
    /// branch that carries it.
    pub axis: Vec<Point3<f64>>,
    /// Radius at each node, m.
    pub radii: Vec<f64>,
    /// Whether the first place belongs to another branch.
    pub carried: bool,
}

impl Tube {
    /// Arc length along the axis to each node, m.
    pub(super) fn arc_m(&self) -> Vec<f64> {
        arc_m(&self.axis)
    }
}

/// Arc length along a polyline to each of its places, m.
pub(super) fn arc_m(places: &[Point3<f64>]) -> Vec<f64> {
    let lengths = places.windows(2).map(|pair| (pair[1] - pair[0]).norm());
    let sums = lengths.scan(0.0, |sum, length| {
        *sum += length;
        Some(*sum)
    });
    std::iter::once(0.0).chain(sums).collect()
}

/// The tubes of all branches, in their order: parents come first.
pub(super) fn tubes(
    points: &[Point3<f64>],
    views: &Views,
    nodes: &[SkeletonNode],
    branches: &[Branch],
) -> Vec<Tube> {
    let mut axis: Vec<Point3<f64>> = nodes.iter().map(|node| node.place).collect();
    let mut radius = vec![RADIUS_M[0]; nodes.len()];
    for branch in branches {
        let own = branch.own();
        let seen = seen_widths(points, views, nodes, own);
        let radii = taper(&arc_m(&own.iter().map(|&node| axis[node]).collect::<Vec<_>>()), &seen);
        for (at, &node) in own.iter().enumerate() {
            radius[node] = radii[at];
            // Points on the side that a camera sees are on average radius · π / 4 in front of the axis.
            axis[node] =
                seen.middle[at] + seen.away[at] * (std::f64::consts::FRAC_PI_4 * radii[at]);
        }
        smooth(&mut axis, own);
    }
    for branch in branches {
        let own = branch.own();
        let members: Vec<Point3<f64>> = (own.iter())
            .flat_map(|&node| nodes[node].members.iter().map(|&point| points[point as usize]))
            .collect();
        let start: Vec<Point3<f64>> = branch.nodes.iter().map(|&node| axis[node]).collect();
        let ends = [radius[own[0]], radius[own[own.len() - 1]]];
        let Some(fitted) = fit(&members, &start, ends, branch.carried) else { continue };
        for (at, &node) in branch.nodes.iter().enumerate().skip(usize::from(branch.carried)) {
            (axis[node], radius[node]) = fitted[at];
        }
    }
    let tube = |branch: &Branch| {
        let mut radii: Vec<f64> = branch.nodes.iter().map(|&node| radius[node]).collect();
        if branch.carried && radii.len() > 1 {
            radii[0] = radii[1];
        }
        let axis = branch.nodes.iter().map(|&node| axis[node]).collect();
        Tube { axis, radii, carried: branch.carried }
    };
    branches.iter().map(tube).collect()
}

/// The seen width and position of each node of a branch.
struct Seen {
    /// Half the width across the line of sight of the camera that saw the most points, m.
    half_width: Vec<f64>,
    /// Weight of the width.
    weight: Vec<f64>,
    /// Smoothed mean of the points, m.
    middle: Vec<Point3<f64>>,
    /// Direction away from the camera, perpendicular to the branch; shorter the more the camera looks along it. The
    /// mean over the points: zero if half of them were seen from each side.
    away: Vec<Vector3<f64>>,
}

fn seen_widths(
    points: &[Point3<f64>],
    views: &Views,
    nodes: &[SkeletonNode],
    own: &[usize],
) -> Seen {
    let n = own.len();
    let mean = |from: usize, to: usize| {
        let places = own[from..to].iter().map(|&node| nodes[node].place.coords);
        Point3::from(places.sum::<Vector3<f64>>() / (to - from) as f64)
    };
    let middle: Vec<Point3<f64>> =
        (0..n).map(|at| mean(at.saturating_sub(2), (at + 3).min(n))).collect();
    let mut seen = Seen { half_width: Vec::new(), weight: Vec::new(), middle, away: Vec::new() };
    for at in 0..n {
        let (before, after) = (at.saturating_sub(1), (at + 1).min(n - 1));
        let tangent = match n {
            1 | 2 => direction_of_short(nodes, own),
            _ => seen.middle[after] - seen.middle[before],
        };
        let tangent = tangent.try_normalize(1e-9).unwrap_or(Vector3::z());
        let mut by_view: Vec<Vec<Point3<f64>>> = vec![Vec::new(); views.all.len()];
        for &point in own[before..=after].iter().flat_map(|&node| &nodes[node].members) {
            by_view[views.of_wood[point as usize]].push(points[point as usize]);
        }
        let n_members: usize = by_view.iter().map(Vec::len).sum();
        let sight = |view: &View| (seen.middle[at] - view.viewpoint).normalize();
        let pairs = views.all.iter().zip(&by_view);
        let away = pairs.clone().map(|(view, members)| {
            let sight = sight(view);
            (sight - tangent * sight.dot(&tangent)) * (members.len() as f64 / n_members as f64)
        });
        seen.away.push(away.sum());
        let (view, members) =
            pairs.rev().max_by_key(|(_, members)| members.len()).expect("there is a picture");
        let across = tangent.cross(&sight(view));
        let sine = across.norm();
        let across = across / (sine + 1e-9);
        let (half_width, area_half_width) =
            widths(members, (&seen.middle[at], &tangent, &across), view, sine.max(0.3));
        seen.half_width.push(half_width.min(area_half_width));
        seen.weight.push(members.len() as f64 * f64::from(u8::from(sine > 0.3)) + 1e-3);
    }
    seen
}

fn direction_of_short(nodes: &[SkeletonNode], own: &[usize]) -> Vector3<f64> {
    let (first, last) = (&nodes[own[0]], &nodes[own[own.len() - 1]]);
    let from = first.parent.map_or(first.place, |parent| nodes[parent].place);
    last.place - from
}

/// Two estimates of half the width of points across the line of sight, m: from their spread about a straight line,
/// and from the area that they cover in the picture.
fn widths(
    members: &[Point3<f64>],
    (middle, tangent, across): (&Point3<f64>, &Vector3<f64>, &Vector3<f64>),
    view: &View,
    sine: f64,
) -> (f64, f64) {
    let n = members.len() as f64;
    let along: Vec<f64> = members.iter().map(|point| (point - middle).dot(tangent)).collect();
    let wide: Vec<f64> = members.iter().map(|point| (point - middle).dot(across)).collect();
    let (mean_along, mean_wide) = (along.iter().sum::<f64>() / n, wide.iter().sum::<f64>() / n);
    let sum = |of: &dyn Fn(f64, f64) -> f64| {
        along.iter().zip(&wide).map(|(a, w)| of(a - mean_along, w - mean_wide)).sum::<f64>()
    };
    let (aa, aw, ww) = (sum(&|a, _| a * a), sum(&|a, w| a * w), sum(&|_, w| w * w));
    let slope = if members.len() > 6 && aa > 0.0 { aw / aa } else { 0.0 };
    let variance = ((ww - slope * aw) / n).max(0.0);
    let low = along.iter().copied().fold(f64::INFINITY, f64::min);
    let high = along.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    // The factor accounts for pixels at the edge, which are partly covered.
    let pixel =
        |point: &Point3<f64>| 0.9 * ((point - view.viewpoint).norm() * view.pixel_rad).powi(2);
    let area: f64 = members.iter().map(pixel).sum();
    // Half a pixel is added at each end, between the outermost points and the edges.
    let length = high - low + (area / n).sqrt();
    (3.0_f64.sqrt() * variance.sqrt(), area / (2.0 * length * sine))
}

/// Radii along a branch, m: a straight line through the half-widths that does not grow towards the tip. Parts that are
/// hidden only look narrower, so widths above the line have more weight.
fn taper(arc: &[f64], seen: &Seen) -> Vec<f64> {
    let n = arc.len();
    let clamp = |radius: f64| radius.clamp(RADIUS_M[0], RADIUS_M[1]);
    let average = |weights: &[f64]| {
        let total: f64 = weights.iter().sum();
        seen.half_width.iter().zip(weights).map(|(r, w)| r * w).sum::<f64>() / total
    };
    if n < 4 {
        return vec![clamp(average(&seen.weight)); n];
    }
    let mut weights = seen.weight.clone();
    let mut line = Vector2::zeros();
    for _ in 0..10 {
        line = fit_line(arc, &seen.half_width, &weights);
        let apart: Vec<f64> =
            (0..n).map(|at| seen.half_width[at] - line[0] - line[1] * arc[at]).collect();
        let mut sizes: Vec<f64> = apart.iter().map(|apart| apart.abs()).collect();
        let scale = 2.0 * (upper_median(&mut sizes).unwrap_or(0.0) + 2e-4);
        for at in 0..n {
            let side = if apart[at] > 0.0 { 1.0 } else { 0.5 };
            weights[at] = seen.weight[at] * side / (1.0 + (apart[at] / scale).powi(2));
        }
    }
    if line[1] > 0.0 {
        return vec![clamp(average(&weights)); n];
    }
    arc.iter().map(|arc| clamp(line[0] + line[1] * arc)).collect()
}

/// Offset and slope of the weighted least-squares line.
pub(super) fn fit_line(x: &[f64], y: &[f64], weights: &[f64]) -> Vector2<f64> {
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for ((&x, &y), &weight) in x.iter().zip(y).zip(weights) {
        let row = Vector2::new(1.0, x);
        normal += weight * row * row.transpose();
        right += weight * y * row;
    }
    normal += Matrix2::from_diagonal_element(1e-12 * normal.trace().max(1e-300));
    normal.try_inverse().map_or(Vector2::zeros(), |inverse| inverse * right)
}

fn smooth(axis: &mut [Point3<f64>], own: &[usize]) {
    let n = own.len();
    if n < 5 {
        return;
    }
    let before: Vec<Vector3<f64>> = own.iter().map(|&node| axis[node].coords).collect();
    for at in 0..n {
        let (from, to) = (at.saturating_sub(1), (at + 2).min(n));
        let sum: Vector3<f64> = before[from..to].iter().sum();
        axis[own[at]] = Point3::from(sum / (to - from) as f64);
    }
}

/// The place on a polyline at an arc length.
pub(super) fn at_arc(places: &[Point3<f64>], arc: &[f64], at: f64) -> Point3<f64> {
    let after = arc.partition_point(|&arc| arc < at).clamp(1, arc.len() - 1);
    let (low, high) = (arc[after - 1], arc[after]);
    let share = if high > low { ((at - low) / (high - low)).clamp(0.0, 1.0) } else { 0.0 };
    places[after - 1] + (places[after] - places[after - 1]) * share
}
