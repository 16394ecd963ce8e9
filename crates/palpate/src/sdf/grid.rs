//! Signed distance by trilinear interpolation between baked nodes.

use nalgebra::{Point3, Vector3, vector};

/// Signed distances of one link at the nodes of a regular lattice, in the link frame.
///
/// Between nodes the distance is trilinear, so it is continuous, its slope jumps from cell to
/// cell, and a detail smaller than the spacing is lost: a plate thinner than a cell may have no
/// inside at all, although the distance outside it is still right.
#[derive(Debug, Clone, PartialEq)]
pub struct DistanceGrid {
    /// Node (0, 0, 0).
    pub(super) origin_m: Point3<f64>,
    pub(super) spacing_m: f64,
    /// Nodes along x, y, z; at least two each.
    pub(super) shape: [usize; 3],
    /// The box that holds the surface.
    pub(super) surface: [Point3<f64>; 2],
    /// Signed distances, m, x running fastest.
    pub(super) nodes_m: Vec<f32>,
    /// Derived from the fields above, for fast queries.
    pub(super) cells_per_m: f64,
    pub(super) last_cell: [f64; 3],
    strides: [usize; 2],
}

/// Squared slope, in (metres per cell)², below which its direction is dominated by rounding errors.
const FLAT: f64 = 1e-16;

/// Number of points whose distances are computed together by [`DistanceGrid::distances_and_normals`].
pub(crate) const LANES: usize = 8;

/// One number for each point of a batch.
pub(crate) type Lanes<T> = [T; LANES];

/// Eight nodes and a position between them.
struct GridCell {
    /// Pairs along x; y runs faster than z.
    nodes_m: [[f32; 2]; 4],
    /// 0..=1 along x, y, z.
    fraction: [f32; 3],
}

impl GridCell {
    #[inline]
    fn value(&self) -> f32 {
        let [x, y, z] = self.fraction;
        let [ab, cd, ef, gh] = self.nodes_m.map(|[low, high]| lerp(low, high, x));
        lerp(lerp(ab, cd, y), lerp(ef, gh, y), z)
    }

    /// The value, and its slope per cell.
    #[inline]
    fn value_and_slope(&self) -> (f32, Vector3<f64>) {
        let [x, y, z] = self.fraction;
        let [ab, cd, ef, gh] = self.nodes_m.map(|[low, high]| lerp(low, high, x));
        let [a, c, e, g] = self.nodes_m.map(|[low, high]| high - low);
        let (low, high) = (lerp(ab, cd, y), lerp(ef, gh, y));
        let slope = [lerp(lerp(a, c, y), lerp(e, g, y), z), lerp(cd - ab, gh - ef, z), high - low];
        (lerp(low, high, z), Vector3::from(slope.map(f64::from)))
    }
}

/// The quadratic B-spline about three nodes, `t` cells from the middle one, −½..½.
struct Spline {
    weights: [f64; 3],
    /// Derivatives of the weights, per cell.
    slopes: [f64; 3],
}

impl Spline {
    #[inline]
    fn at(t: f64) -> Self {
        let (low, high) = (0.5 - t, 0.5 + t);
        Self {
            weights: [0.5 * low * low, 0.75 - t * t, 0.5 * high * high],
            slopes: [-low, -2.0 * t, high],
        }
    }
}

impl DistanceGrid {
    /// Puts a grid together; `nodes_m` holds `shape` nodes, x fastest.
    pub(super) fn new(
        origin_m: Point3<f64>,
        spacing_m: f64,
        shape: [usize; 3],
        surface: [Point3<f64>; 2],
        nodes_m: Vec<f32>,
    ) -> DistanceGrid {
        assert!(shape.iter().all(|&n| n >= 2), "a cell has two nodes along each axis");
        assert_eq!(nodes_m.len(), shape.iter().product::<usize>(), "one distance for each node");
        let last_cell = shape.map(|n| (n - 1) as f64);
        let cells_per_m = spacing_m.recip();
        let strides = [shape[0], shape[0] * shape[1]];
        DistanceGrid {
            origin_m,
            spacing_m,
            shape,
            surface,
            nodes_m,
            cells_per_m,
            last_cell,
            strides,
        }
    }

    /// Signed distance of a point from the surface, m; negative inside.
    ///
    /// Within the grid, `φ` is trilinear between the nodes. Outside it is `√(φ(c)² + |p−c|²)` with `c` the nearest
    /// point of the grid: continuous, at least the margin that the grid was baked with, and never more than the true
    /// distance (but for the interpolation of `φ(c)`). So a point with `φ > x` really is farther than x, for every x.
    ///
    /// `point_link` is in the link frame. Cost: 8 reads from at most 4 cache lines.
    #[inline]
    pub fn distance(&self, point_link: &Point3<f64>) -> f64 {
        let scaled = (point_link - self.origin_m) * self.cells_per_m;
        if self.holds(&scaled) {
            return f64::from(self.cell(&scaled).value());
        }
        let (cell, excess) = self.nearest_cell(&scaled);
        (f64::from(cell.value()).powi(2) + excess.norm_squared()).sqrt()
    }

    /// [`DistanceGrid::distance`], and the unit vector that points away from the surface.
    ///
    /// The normal is the normalised gradient of the interpolated distance, exact within a cell. Where the gradient
    /// vanishes (the centre of a ball) the normal points away from the centre of the link; it is a unit vector
    /// everywhere.
    #[inline]
    pub fn distance_and_normal(&self, point_link: &Point3<f64>) -> (f64, Vector3<f64>) {
        let scaled = (point_link - self.origin_m) * self.cells_per_m;
        if self.holds(&scaled) {
            let (value, slope) = self.cell(&scaled).value_and_slope();
            return (f64::from(value), self.unit(slope, point_link));
        }
        let (cell, excess) = self.nearest_cell(&scaled);
        let (value, slope) = cell.value_and_slope();
        let inner = f64::from(value);
        // Beyond the grid only the slope along its faces counts: φ(c) does not change across them.
        let along = Vector3::from_fn(|i, _| if excess[i] == 0.0 { slope[i] } else { 0.0 });
        let uphill = inner * self.cells_per_m * along + excess;
        ((inner * inner + excess.norm_squared()).sqrt(), self.unit(uphill, point_link))
    }

    /// [`DistanceGrid::distance_and_normal`] of a batch of points, to the bit: coordinates by axis, by point.
    ///
    /// The loops over lanes are written out, so that they are compiled for the instruction set of the caller.
    #[inline(always)]
    pub(crate) fn distances_and_normals(
        &self,
        points_link: &[Lanes<f64>; 3],
    ) -> (Lanes<f64>, [Lanes<f64>; 3]) {
        let (mut cell, mut fraction) = ([[0_i32; LANES]; 3], [[0.0_f32; LANES]; 3]);
        let mut is_inside = true;
        for axis in 0..3 {
            let (origin, last) = (self.origin_m[axis], self.last_cell[axis]);
            for lane in 0..LANES {
                let scaled = (points_link[axis][lane] - origin) * self.cells_per_m;
                is_inside &= (scaled >= 0.0) & (scaled < last);
                cell[axis][lane] = scaled as i32;
                fraction[axis][lane] = (scaled - f64::from(cell[axis][lane])) as f32;
            }
        }
        if !is_inside {
            return self.one_by_one(points_link);
        }
        let (value, slope) = values_and_slopes(&self.nodes_of(&cell), &fraction);
        let mut norm_sq = [0.0; LANES];
        let mut is_steep = true;
        for lane in 0..LANES {
            let [x, y, z] = [slope[0][lane], slope[1][lane], slope[2][lane]];
            norm_sq[lane] = x * x + y * y + z * z;
            is_steep &= norm_sq[lane] > FLAT;
        }
        if !is_steep {
            return self.one_by_one(points_link);
        }
        let (mut distance_m, mut normal) = ([0.0; LANES], slope);
        for lane in 0..LANES {
            let factor = norm_sq[lane].sqrt().recip();
            distance_m[lane] = f64::from(value[lane]);
            for normal in &mut normal {
                normal[lane] *= factor;
            }
        }
        (distance_m, normal)
    }

    /// [`DistanceGrid::distances_and_normals`] of points of which some are beyond the grid, or where it is flat.
    #[cold]
    #[inline(never)]
    fn one_by_one(&self, points_link: &[Lanes<f64>; 3]) -> (Lanes<f64>, [Lanes<f64>; 3]) {
        let (mut distance_m, mut normal) = ([0.0; LANES], [[0.0; LANES]; 3]);
        for lane in 0..LANES {
            let point = Point3::from(points_link.map(|axis| axis[lane]));
            let (distance, unit) = self.distance_and_normal(&point);
            distance_m[lane] = distance;
            (0..3).for_each(|axis| normal[axis][lane] = unit[axis]);
        }
        (distance_m, normal)
    }

    /// The eight nodes of each cell, in the order of [`GridCell::nodes_m`].
    #[inline(always)]
    fn nodes_of(&self, cell: &[Lanes<i32>; 3]) -> [Lanes<f32>; 8] {
        let [row, plane] = self.strides;
        let mut nodes_m = [[0.0; LANES]; 8];
        for lane in 0..LANES {
            let [x, y, z] = [cell[0][lane], cell[1][lane], cell[2][lane]].map(|n| n as usize);
            let base = x + row * y + plane * z;
            let nodes = &self.nodes_m[base..base + plane + row + 2];
            nodes_m[0][lane] = nodes[0];
            nodes_m[1][lane] = nodes[1];
            nodes_m[2][lane] = nodes[row];
            nodes_m[3][lane] = nodes[row + 1];
            nodes_m[4][lane] = nodes[plane];
            nodes_m[5][lane] = nodes[plane + 1];
            nodes_m[6][lane] = nodes[plane + row];
            nodes_m[7][lane] = nodes[plane + row + 1];
        }
        nodes_m
    }

    /// Smoothed signed distance, m, and its gradient, which is nearly a unit vector; both are continuous.
    ///
    /// Quadratic B-splines of the nodes: within the grid the value differs from [`DistanceGrid::distance`] by an eighth
    /// of the spacing squared times the surface's curvature, and edges are rounded by the spacing. Where a node beyond
    /// the grid would be needed, the result is that of [`DistanceGrid::distance_and_normal`]. Cost: 27 reads.
    pub fn smooth_distance_and_slope(&self, point_link: &Point3<f64>) -> (f64, Vector3<f64>) {
        let scaled = (point_link - self.origin_m) * self.cells_per_m;
        let inner = |axis: usize| scaled[axis] > 0.5 && scaled[axis] < self.last_cell[axis] - 0.5;
        if !(inner(0) && inner(1) && inner(2)) {
            return self.distance_and_normal(point_link);
        }
        let nearest = scaled.map(f64::round);
        let [x, y, z] = [0, 1, 2].map(|axis| Spline::at(scaled[axis] - nearest[axis]));
        let first = [0, 1, 2].map(|axis| nearest[axis] as usize - 1);
        let (mut value, mut slope) = (0.0, Vector3::zeros());
        for k in 0..3 {
            for j in 0..3 {
                let row =
                    first[0] + self.strides[0] * (first[1] + j) + self.strides[1] * (first[2] + k);
                let nodes = &self.nodes_m[row..row + 3];
                let [a, b, c] = [0, 1, 2].map(|i| f64::from(nodes[i]));
                let along = x.weights[0] * a + x.weights[1] * b + x.weights[2] * c;
                let by_x = x.slopes[0] * a + x.slopes[1] * b + x.slopes[2] * c;
                value += y.weights[j] * z.weights[k] * along;
                slope.x += y.weights[j] * z.weights[k] * by_x;
                slope.y += y.slopes[j] * z.weights[k] * along;
                slope.z += y.weights[j] * z.slopes[k] * along;
            }
        }
        (value, slope * self.cells_per_m)
    }

    /// A box around the surface and everything inside it, in the link frame: lowest and highest
    /// corner. `φ > 0` holds outside it.
    pub fn bounds(&self) -> (Point3<f64>, Point3<f64>) {
        (self.surface[0], self.surface[1])
    }

    /// Points of the surface, in the link frame: one wherever it crosses a line between two
    /// neighbouring nodes, with the distance taken as linear along it.
    ///
    /// They are for drawing, and as dense as the nodes: a plate thinner than a cell may have none. Cost: one pass over
    /// the nodes.
    pub fn surface_points(&self) -> Vec<Point3<f64>> {
        let [nx, ny, _] = self.shape;
        let strides = [1, self.strides[0], self.strides[1]];
        let mut points = Vec::new();
        for at in 0..self.nodes_m.len() {
            let place = [at % nx, at / nx % ny, at / (nx * ny)];
            for axis in (0..3).filter(|&axis| place[axis] + 1 < self.shape[axis]) {
                let (here, there) = (self.nodes_m[at], self.nodes_m[at + strides[axis]]);
                if (here < 0.0) != (there < 0.0) {
                    let mut steps = Vector3::from(place.map(|n| n as f64));
                    steps[axis] += f64::from(here / (here - there));
                    points.push(self.origin_m + steps * self.spacing_m);
                }
            }
        }
        points
    }

    /// Distance between nodes, m.
    pub fn spacing_m(&self) -> f64 {
        self.spacing_m
    }

    /// Nodes along x, y and z.
    pub fn shape(&self) -> [usize; 3] {
        self.shape
    }

    /// Bytes that the nodes take.
    pub(crate) fn size_bytes(&self) -> usize {
        self.nodes_m.len() * size_of::<f32>()
    }

    /// All numbers of the grid, for fingerprints.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = f64> {
        let shape = self.shape.into_iter().map(|n| n as f64);
        let nodes = self.nodes_m.iter().copied().map(f64::from);
        shape.chain([self.spacing_m]).chain(self.origin_m.iter().copied()).chain(nodes)
    }

    /// Whether a point, in cells from the first node, lies in the grid.
    #[inline]
    fn holds(&self, scaled: &Vector3<f64>) -> bool {
        let within = |axis: usize| (scaled[axis] >= 0.0) & (scaled[axis] < self.last_cell[axis]);
        within(0) & within(1) & within(2)
    }

    /// The cell of a point that the grid holds.
    #[inline(always)] // without it, whether it is inlined changes with code elsewhere: 9 % of a contact step
    fn cell(&self, scaled: &Vector3<f64>) -> GridCell {
        let (mut index, mut fraction) = ([0; 3], [0.0; 3]);
        for axis in 0..3 {
            index[axis] = scaled[axis] as u32 as usize;
            fraction[axis] = (scaled[axis] - index[axis] as f64) as f32;
        }
        let [row, plane] = self.strides;
        let base = index[0] + row * index[1] + plane * index[2];
        let pair = |at: usize| {
            let pair = &self.nodes_m[at..at + 2];
            [pair[0], pair[1]]
        };
        let nodes_m = [pair(base), pair(base + row), pair(base + plane), pair(base + plane + row)];
        GridCell { nodes_m, fraction }
    }

    /// The cell nearest to a point, with the nearest position in it, and the vector from there to the point, m.
    #[cold]
    fn nearest_cell(&self, scaled: &Vector3<f64>) -> (GridCell, Vector3<f64>) {
        // The last node belongs to the cell before it; NaN is replaced by the first node.
        let inside = Vector3::from_fn(|axis, _| {
            scaled[axis].max(0.0).min(self.last_cell[axis] * (1.0 - f64::EPSILON))
        });
        let excess = (scaled - inside) * self.spacing_m;
        (self.cell(&inside), excess)
    }

    fn unit(&self, slope: Vector3<f64>, point: &Point3<f64>) -> Vector3<f64> {
        let norm_sq = slope.norm_squared();
        if norm_sq > FLAT {
            return slope * norm_sq.sqrt().recip();
        }
        let away = point - nalgebra::center(&self.surface[0], &self.surface[1]);
        away.try_normalize(1e-9).unwrap_or(vector![0.0, 0.0, 1.0])
    }
}

/// [`GridCell::value_and_slope`] of a batch.
#[inline(always)]
fn values_and_slopes(
    nodes_m: &[Lanes<f32>; 8],
    [x, y, z]: &[Lanes<f32>; 3],
) -> (Lanes<f32>, [Lanes<f64>; 3]) {
    let (mut value, mut slope) = ([0.0; LANES], [[0.0; LANES]; 3]);
    for lane in 0..LANES {
        let (x, y, z) = (x[lane], y[lane], z[lane]);
        let [a, b, c, d] = [nodes_m[0][lane], nodes_m[1][lane], nodes_m[2][lane], nodes_m[3][lane]];
        let [e, f, g, h] = [nodes_m[4][lane], nodes_m[5][lane], nodes_m[6][lane], nodes_m[7][lane]];
        let (ab, cd, ef, gh) = (lerp(a, b, x), lerp(c, d, x), lerp(e, f, x), lerp(g, h, x));
        let (low, high) = (lerp(ab, cd, y), lerp(ef, gh, y));
        value[lane] = lerp(low, high, z);
        slope[0][lane] = f64::from(lerp(lerp(b - a, d - c, y), lerp(f - e, h - g, y), z));
        slope[1][lane] = f64::from(lerp(cd - ab, gh - ef, z));
        slope[2][lane] = f64::from(high - low);
    }
    (value, slope)
}

#[inline(always)]
fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

#[cfg(test)]
mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    use super::*;

    #[test]
    fn a_batch_of_points_has_the_distances_and_normals_of_single_points_to_the_bit() {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let mut uniform = || f64::from(rng.next_u32()) / f64::from(u32::MAX);
        let shape = [5, 6, 7];
        let surface = [Point3::new(0.1, 0.1, 0.1), Point3::new(0.3, 0.4, 0.5)];
        let mut nodes_m: Vec<f32> = (0..5 * 6 * 7).map(|_| uniform() as f32).collect();
        nodes_m[..2 * 5 * 6].fill(0.25); // no slope between the first two planes
        let grid = DistanceGrid::new(Point3::origin(), 0.1, shape, surface, nodes_m);
        // Points inside the grid; where it is flat; some of them beyond it.
        for [low, high] in [[0.1, 0.39], [0.0, 0.39], [-0.2, 0.8]] {
            for _ in 0..50 {
                let points = [0; 3].map(|_| [0; LANES].map(|_| low + (high - low) * uniform()));
                let (distance_m, normal) = grid.distances_and_normals(&points);
                for lane in 0..LANES {
                    let point = Point3::from(points.map(|axis| axis[lane]));
                    let (distance, unit) = grid.distance_and_normal(&point);
                    assert_eq!(distance_m[lane].to_bits(), distance.to_bits());
                    assert_eq!(Vector3::from(normal.map(|axis| axis[lane])), unit);
                }
            }
        }
    }
}
