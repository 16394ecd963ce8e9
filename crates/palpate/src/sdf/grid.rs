//! Signed distance by trilinear interpolation between baked nodes.

use nalgebra::{Point3, Vector3, vector};

/// Signed distances of one link at the nodes of a regular lattice, in the link frame.
///
/// Between nodes the distance is trilinear, so it is continuous, its slope jumps from cell to
/// cell, and a detail smaller than the spacing is lost: a plate thinner than a cell may have no
/// inside at all, although the distance outside it is still right.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Node (0, 0, 0).
    pub(super) origin_m: Point3<f64>,
    pub(super) spacing_m: f64,
    /// Nodes along x, y, z; at least two each.
    pub(super) shape: [usize; 3],
    /// The box that holds the surface.
    pub(super) surface: [Point3<f64>; 2],
    /// Signed distances, m, x running fastest.
    pub(super) nodes_m: Vec<f32>,
    /// Derived from the above: what a query needs, ready to multiply with.
    pub(super) cells_per_m: f64,
    pub(super) last_cell: [f64; 3],
}

/// A cell of the grid and where in it a point falls.
struct Cell {
    /// Index of its lowest node.
    base: usize,
    /// 0..=1 along x, y, z.
    fraction: [f32; 3],
    /// From the nearest point of the grid to the point, m; zero within the grid.
    excess: Vector3<f64>,
}

impl Grid {
    /// Puts a grid together; `nodes_m` holds `shape` nodes, x fastest.
    pub(super) fn new(
        origin_m: Point3<f64>,
        spacing_m: f64,
        shape: [usize; 3],
        surface: [Point3<f64>; 2],
        nodes_m: Vec<f32>,
    ) -> Grid {
        assert!(shape.iter().all(|&n| n >= 2), "a cell has two nodes along each axis");
        assert_eq!(nodes_m.len(), shape.iter().product::<usize>(), "one distance a node");
        let last_cell = shape.map(|n| (n - 1) as f64);
        let cells_per_m = spacing_m.recip();
        Grid { origin_m, spacing_m, shape, surface, nodes_m, cells_per_m, last_cell }
    }

    /// Signed distance of a point from the surface, m; negative inside.
    ///
    /// Within the grid, `φ` is trilinear between the nodes. Outside it is `√(φ(c)² + |p−c|²)` with
    /// `c` the nearest point of the grid: continuous, at least the margin that the grid was baked
    /// with, and never more than the true distance (but for the interpolation of `φ(c)`), so
    /// "farther than x" can be believed for every x.
    ///
    /// `point_link` is in the link frame. Cost: 8 reads from at most 4 cache lines.
    pub fn distance(&self, point_link: &Point3<f64>) -> f64 {
        let cell = self.cell(point_link);
        let [[a, b], [c, d], [e, f], [g, h]] = self.corners(cell.base);
        let [x, y, z] = cell.fraction;
        let (low, high) = (
            lerp(lerp(a, b, x), lerp(c, d, x), y), //
            lerp(lerp(e, f, x), lerp(g, h, x), y),
        );
        let inner = f64::from(lerp(low, high, z));
        let excess_sq = cell.excess.norm_squared();
        if excess_sq == 0.0 { inner } else { (inner * inner + excess_sq).sqrt() }
    }

    /// [`Grid::distance`], and the unit vector that points away from the surface.
    ///
    /// The normal is the normalised gradient of the interpolated distance, exact within a cell.
    /// Where the gradient vanishes (the middle of a ball) no direction is better than another and
    /// the normal points away from the middle of the link; it is a unit vector everywhere.
    pub fn distance_and_normal(&self, point_link: &Point3<f64>) -> (f64, Vector3<f64>) {
        let cell = self.cell(point_link);
        let [[a, b], [c, d], [e, f], [g, h]] = self.corners(cell.base);
        let [x, y, z] = cell.fraction;
        // The four edges along x, folded along y, then along z.
        let [ab, cd, ef, gh] = [lerp(a, b, x), lerp(c, d, x), lerp(e, f, x), lerp(g, h, x)];
        let (low, high) = (lerp(ab, cd, y), lerp(ef, gh, y));
        let inner = f64::from(lerp(low, high, z));
        let slope = Vector3::new(
            f64::from(lerp(lerp(b - a, d - c, y), lerp(f - e, h - g, y), z)),
            f64::from(lerp(cd - ab, gh - ef, z)),
            f64::from(high - low),
        ) * self.cells_per_m;

        let excess_sq = cell.excess.norm_squared();
        if excess_sq == 0.0 {
            return (inner, self.unit(slope, point_link));
        }
        // Beyond the grid only the slope along its faces counts: φ(c) does not change across them.
        let along = Vector3::from_fn(|i, _| if cell.excess[i] == 0.0 { slope[i] } else { 0.0 });
        let distance = (inner * inner + excess_sq).sqrt();
        (distance, self.unit(inner * along + cell.excess, point_link))
    }

    /// A box around the surface and everything inside it, in the link frame: lowest and highest
    /// corner. `φ > 0` holds outside it.
    pub fn bounds(&self) -> (Point3<f64>, Point3<f64>) {
        (self.surface[0], self.surface[1])
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
    pub fn size_bytes(&self) -> usize {
        self.nodes_m.len() * size_of::<f32>()
    }

    /// Everything that makes a grid what it is, for fingerprints.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = f64> {
        let shape = self.shape.into_iter().map(|n| n as f64);
        let nodes = self.nodes_m.iter().copied().map(f64::from);
        shape.chain([self.spacing_m]).chain(self.origin_m.iter().copied()).chain(nodes)
    }

    /// The cell that holds a point, or the one nearest to it.
    #[inline]
    fn cell(&self, point: &Point3<f64>) -> Cell {
        let scaled = (point - self.origin_m) * self.cells_per_m;
        let mut index = [0_usize; 3];
        let mut fraction = [0.0_f32; 3];
        let mut excess = Vector3::zeros();
        for axis in 0..3 {
            let inside = scaled[axis].clamp(0.0, self.last_cell[axis]);
            excess[axis] = (scaled[axis] - inside) * self.spacing_m;
            // The last node is the far end of the last cell. NaN becomes cell 0.
            index[axis] = (inside as usize).min(self.shape[axis] - 2);
            fraction[axis] = (inside - index[axis] as f64) as f32;
        }
        let base = index[0] + self.shape[0] * (index[1] + self.shape[1] * index[2]);
        Cell { base, fraction, excess }
    }

    /// The nodes of a cell, pairs along x; y runs faster than z.
    #[inline]
    fn corners(&self, base: usize) -> [[f32; 2]; 4] {
        let (row, plane) = (self.shape[0], self.shape[0] * self.shape[1]);
        let pair = |at: usize| [self.nodes_m[at], self.nodes_m[at + 1]];
        [pair(base), pair(base + row), pair(base + plane), pair(base + plane + row)]
    }

    fn unit(&self, slope: Vector3<f64>, point: &Point3<f64>) -> Vector3<f64> {
        let norm_sq = slope.norm_squared();
        if norm_sq > 1e-12 {
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
