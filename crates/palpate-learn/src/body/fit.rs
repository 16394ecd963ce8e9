//! Fits a tapering tube to points of its seen side.
//!
//! Robust least squares of (distance from the axis − radius) with a smooth axis, by Gauss-Newton with
//! analytic derivatives. The derivatives keep the nearest place on the axis fixed: its motion along the
//! axis changes the distance in second order only.

use nalgebra::{DMatrix, DVector, Point3, Vector3};

use super::tubes::{RADIUS_M, arc_m, at_arc};

/// Distance between the nodes of the axis, m.
const STEP_M: f64 = 0.015;
/// Standard deviation of a point's distance from the surface, m.
const POINT_STD_M: f64 = 0.001;
/// Standard deviation of the second differences of the axis, m.
const BEND_STD_M: f64 = 0.0015;
/// Standard deviation of the lengths of the pieces of the axis, m.
const LENGTH_STD_M: f64 = 0.002;
/// Standard deviation of the radii about those of the seen widths, m.
const RADIUS_STD_M: f64 = 0.0006;
/// Standard deviation of a growth of the radius towards the tip, m.
const GROWTH_STD_M: f64 = 0.0002;
/// Longer branches are not fitted, m: plants have none, and time grows with the cube of the length.
const LONGEST_M: f64 = 3.0;
/// Most points per ten centimetres of a branch.
const MAX_POINTS: f64 = 350.0;
/// Most steps, and the change below which the fit has converged, m.
const STEPS: usize = 12;
const SETTLED_M: f64 = 1e-5;
/// Largest change in a step, m.
const LONGEST_STEP_M: f64 = 0.004;

/// Axis and radius, m, at each place of `start`, of the tube that fits the points best; `None` if there are too few
/// points or the branch is too short or too long.
///
/// `start`: the initial axis, m; its first place stays fixed if the branch is `carried`. `radii`: at its ends, m.
pub(super) fn fit(
    points: &[Point3<f64>],
    start: &[Point3<f64>],
    radii: [f64; 2],
    carried: bool,
) -> Option<Vec<(Point3<f64>, f64)>> {
    let arc = arc_m(start);
    let length = arc[arc.len() - 1];
    if points.len() < 8 || !(0.01..LONGEST_M).contains(&length) {
        return None;
    }
    let most = (MAX_POINTS * f64::max(1.0, length / 0.1)) as usize;
    let points: Vec<Point3<f64>> =
        points.iter().step_by(points.len().div_ceil(most)).copied().collect();
    let pieces = ((length / STEP_M).round() as usize).max(1);
    let places: Vec<f64> = (0..=pieces).map(|at| length * at as f64 / pieces as f64).collect();
    let mut tube = Fit {
        points: &points,
        axis: places.iter().map(|&place| at_arc(start, &arc, place)).collect(),
        radii,
        first_free: usize::from(carried),
        piece_m: length / pieces as f64,
        radii_before: radii,
    };
    for _ in 0..STEPS {
        if tube.improve() < SETTLED_M {
            break;
        }
    }
    let place = |&arc: &f64| {
        let radius = tube.radii[0] + (tube.radii[1] - tube.radii[0]) * arc / length;
        (at_arc(&tube.axis, &places, arc), radius.clamp(0.0016, RADIUS_M[1]))
    };
    Some(arc.iter().map(place).collect())
}

/// The normal equations of a least-squares step.
struct Normal {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl Normal {
    /// Adds a residual with its derivatives by some unknowns: (index, derivative).
    fn add(&mut self, residual: f64, weight: f64, slope: &[(usize, f64)]) {
        for &(i, a) in slope {
            self.right[i] -= weight * a * residual;
            for &(j, b) in slope {
                self.matrix[(i, j)] += weight * a * b;
            }
        }
    }
}

struct Fit<'a> {
    points: &'a [Point3<f64>],
    axis: Vec<Point3<f64>>,
    /// Radii at the ends of the axis, m.
    radii: [f64; 2],
    /// Index of the first node that may move.
    first_free: usize,
    /// Length of a piece between two nodes at the start, m.
    piece_m: f64,
    /// Radii from the seen widths, m.
    radii_before: [f64; 2],
}

impl Fit<'_> {
    /// One Gauss-Newton step; returns the largest change, m.
    fn improve(&mut self) -> f64 {
        let size = self.column_of_radii() + 2;
        let mut normal = Normal { matrix: DMatrix::zeros(size, size), right: DVector::zeros(size) };
        self.add_points(&mut normal);
        self.add_bends(&mut normal);
        self.add_lengths(&mut normal);
        self.add_radii(&mut normal);
        let Some(factor) = normal.matrix.cholesky() else { return 0.0 };
        let step = factor.solve(&normal.right);
        let longest = step.amax();
        let share = f64::min(1.0, LONGEST_STEP_M / longest);
        for node in self.first_free..self.axis.len() {
            let first = 3 * (node - self.first_free);
            self.axis[node] += share * Vector3::new(step[first], step[first + 1], step[first + 2]);
        }
        for end in 0..2 {
            self.radii[end] = (self.radii[end] + share * step[size - 2 + end]).max(5e-4);
        }
        share * longest
    }

    fn column_of_radii(&self) -> usize {
        3 * (self.axis.len() - self.first_free)
    }

    /// Derivatives by the coordinates of a node, if it may move.
    fn by_node(
        &self,
        node: usize,
        slope: Vector3<f64>,
    ) -> impl Iterator<Item = (usize, f64)> + use<> {
        let first = node.checked_sub(self.first_free).map(|free| 3 * free);
        first.into_iter().flat_map(move |first| (0..3).map(move |axis| (first + axis, slope[axis])))
    }

    /// Residuals (distance from the axis − radius), with the weights of a soft L1 norm.
    fn add_points(&self, normal: &mut Normal) {
        let radii = self.column_of_radii();
        for point in self.points {
            let (piece, share) = self.nearest(point);
            let foot = self.axis[piece] + (self.axis[piece + 1] - self.axis[piece]) * share;
            let apart = point - foot;
            let distance = apart.norm().max(1e-6);
            let along = (piece as f64 + share) / (self.axis.len() - 1) as f64;
            let radius = self.radii[0] + (self.radii[1] - self.radii[0]) * along;
            let residual = (distance - radius) / POINT_STD_M;
            let weight = 0.5 / (1.0 + residual * residual / 4.0).sqrt();
            let towards = -apart / distance / POINT_STD_M;
            let slope: Vec<(usize, f64)> = (self.by_node(piece, (1.0 - share) * towards))
                .chain(self.by_node(piece + 1, share * towards))
                .chain([(radii, -(1.0 - along) / POINT_STD_M), (radii + 1, -along / POINT_STD_M)])
                .collect();
            normal.add(residual, weight, &slope);
        }
    }

    /// Residuals of the second differences of the axis.
    fn add_bends(&self, normal: &mut Normal) {
        for (middle, places) in self.axis.windows(3).enumerate() {
            let bend = places[0].coords - 2.0 * places[1].coords + places[2].coords;
            for axis in 0..3 {
                let unit = Vector3::ith(axis, 1.0 / BEND_STD_M);
                let parts = [(middle, 1.0), (middle + 1, -2.0), (middle + 2, 1.0)];
                let slope =
                    parts.into_iter().flat_map(|(node, part)| self.by_node(node, part * unit));
                let slope: Vec<(usize, f64)> = slope.filter(|(_, part)| *part != 0.0).collect();
                normal.add(bend[axis] / BEND_STD_M, 1.0, &slope);
            }
        }
    }

    /// Residuals of the lengths of the pieces, so that nodes keep their distances.
    fn add_lengths(&self, normal: &mut Normal) {
        for (piece, ends) in self.axis.windows(2).enumerate() {
            let way = ends[1] - ends[0];
            let length = way.norm().max(1e-9);
            let along = way / length / LENGTH_STD_M;
            let slope: Vec<(usize, f64)> =
                self.by_node(piece, -along).chain(self.by_node(piece + 1, along)).collect();
            normal.add((length - self.piece_m) / LENGTH_STD_M, 1.0, &slope);
        }
    }

    /// Residuals of the radii: near those of the seen widths, and not growing towards the tip.
    fn add_radii(&self, normal: &mut Normal) {
        let radii = self.column_of_radii();
        for end in 0..2 {
            let residual = (self.radii[end] - self.radii_before[end]) / RADIUS_STD_M;
            normal.add(residual, 1.0, &[(radii + end, 1.0 / RADIUS_STD_M)]);
        }
        let growth = self.radii[1] - self.radii[0];
        if growth > 0.0 {
            let slope = [(radii, -1.0 / GROWTH_STD_M), (radii + 1, 1.0 / GROWTH_STD_M)];
            normal.add(growth / GROWTH_STD_M, 1.0, &slope);
        }
    }

    /// The piece of the axis nearest to a point, and the nearest place on it, from 0 to 1.
    fn nearest(&self, point: &Point3<f64>) -> (usize, f64) {
        let mut nearest = (f64::INFINITY, 0, 0.0);
        for (piece, ends) in self.axis.windows(2).enumerate() {
            let way = ends[1] - ends[0];
            let share = (point - ends[0]).dot(&way) / (way.norm_squared() + 1e-12);
            let share = share.clamp(0.0, 1.0);
            let squared = (point - (ends[0] + way * share)).norm_squared();
            if squared < nearest.0 {
                nearest = (squared, piece, share);
            }
        }
        (nearest.1, nearest.2)
    }
}
