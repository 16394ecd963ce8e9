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

#[inline]
fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}
