//! The workspace box and its rest points: cell ↔ point, and storage for touched cells.
//!
//! | paper | here                 | value                           | unit |
//! |-------|----------------------|---------------------------------|------|
//! | W     | [`Lattice`]          | box of points at equal spacing  | m    |
//! | pᵢ    | [`Lattice::point`]   | rest point of cell i, world     | m    |
//! |       | [`Bricks`]           | 8³ cells at a time, on demand   |      |
//! |       | [`CellRows`]         | cells numbered by first touch   |      |
//!
//! A lattice stores only origin, spacing and shape: 1000³ points take no memory. Data of cells are stored in bricks,
//! which are created when one of their cells is touched, or in arrays indexed by *row*, the order in which cells were
//! first touched. Stiffness and contact are not used here.

mod bricks;
mod rows;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

pub(crate) use bricks::{BRICK_CELLS, BRICK_EDGE, Bricks, CellSet};
pub use rows::CellRows;
pub(crate) use rows::RowCache;
pub(crate) use rows::RowsOfBricks;

/// A cell's number in its lattice: x runs fastest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct CellId(pub u32);

/// What can be wrong with a workspace box.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum LatticeError {
    /// A spacing that is not positive or not finite.
    #[error("lattice spacing is {found_m} m; it must be a positive, finite length")]
    Spacing { found_m: f64 },
    /// An axis without points.
    #[error("lattice shape is {found:?}; every axis needs at least one point")]
    EmptyAxis { found: [u32; 3] },
    /// A corner that is not finite, or too far from the world's origin.
    #[error(
        "a corner of the lattice is {found:?} m; all three coordinates must be finite, and within \
         {MAX_COORDINATE_M} m of the world's origin; are they in millimetres?"
    )]
    Origin { found: [f64; 3] },
    /// More points than a 32-bit cell number can index.
    #[error(
        "a lattice of {shape:?} has {points} points, more than the {limit} that can be indexed; \
         make the box smaller or the spacing larger"
    )]
    TooManyPoints { shape: [u32; 3], points: u128, limit: u64 },
}

/// Largest coordinate, in absolute value, of anything that an arm touches, m. Larger numbers are in other units, or
/// geographic coordinates, in which numbers lose the digits that contacts need.
pub const MAX_COORDINATE_M: f64 = 1000.0;

/// A box of rest points at equal spacing, aligned with the world's axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "RawLattice", into = "RawLattice")]
pub struct Lattice {
    origin_m: Point3<f64>,
    spacing_m: f64,
    shape: [u32; 3],
}

/// A lattice as stored in files, unchecked.
#[derive(Serialize, Deserialize)]
struct RawLattice {
    origin_m: [f64; 3],
    spacing_m: f64,
    shape: [u32; 3],
}

impl TryFrom<RawLattice> for Lattice {
    type Error = LatticeError;

    fn try_from(raw: RawLattice) -> Result<Self, LatticeError> {
        Self::new(raw.origin_m, raw.spacing_m, raw.shape)
    }
}

impl From<Lattice> for RawLattice {
    fn from(lattice: Lattice) -> Self {
        Self {
            origin_m: lattice.origin_m.into(),
            spacing_m: lattice.spacing_m,
            shape: lattice.shape,
        }
    }
}

impl Default for Lattice {
    /// The paper's box: a 2.4 m cube about the robot's base, 200 points a side, 1.2 cm apart.
    fn default() -> Self {
        Self::new([-1.194; 3], 0.012, [200; 3]).expect("the paper's box is a valid lattice")
    }
}

impl Lattice {
    /// A lattice whose first point is `origin_m`, with `shape` points along x, y and z.
    ///
    /// # Errors
    ///
    /// If the spacing is not a positive length, an axis is empty, the origin is not finite, or
    /// the points outnumber what [`CellId`] can index.
    pub fn new(origin_m: [f64; 3], spacing_m: f64, shape: [u32; 3]) -> Result<Self, LatticeError> {
        if !(spacing_m > 0.0 && spacing_m.is_finite()) {
            return Err(LatticeError::Spacing { found_m: spacing_m });
        }
        if shape.contains(&0) {
            return Err(LatticeError::EmptyAxis { found: shape });
        }
        if origin_m.iter().any(|x| !x.is_finite()) {
            return Err(LatticeError::Origin { found: origin_m });
        }
        let points = shape.iter().map(|&n| u128::from(n)).product::<u128>();
        let limit = u64::from(u32::MAX);
        if points > u128::from(limit) {
            return Err(LatticeError::TooManyPoints { shape, points, limit });
        }
        let high_m =
            std::array::from_fn(|axis| origin_m[axis] + f64::from(shape[axis] - 1) * spacing_m);
        for corner_m in [origin_m, high_m] {
            if corner_m.iter().any(|x: &f64| x.abs() > MAX_COORDINATE_M) {
                return Err(LatticeError::Origin { found: corner_m });
            }
        }
        Ok(Self { origin_m: origin_m.into(), spacing_m, shape })
    }

    /// A lattice that fills the box between two opposite corners, centred in it.
    ///
    /// # Errors
    ///
    /// As [`Lattice::new`]; a box with an edge that is not positive counts as an empty axis.
    pub fn filling(
        low_m: [f64; 3],
        high_m: [f64; 3],
        spacing_m: f64,
    ) -> Result<Self, LatticeError> {
        if !(spacing_m > 0.0 && spacing_m.is_finite()) {
            return Err(LatticeError::Spacing { found_m: spacing_m });
        }
        let mut shape = [0; 3];
        let mut origin_m = [0.0; 3];
        for axis in 0..3 {
            let edge_m = high_m[axis] - low_m[axis];
            if !edge_m.is_finite() {
                return Err(LatticeError::Origin { found: low_m });
            }
            // The tolerance keeps 2.4 m / 12 mm at 200 points in spite of rounding.
            let count = (edge_m / spacing_m + 1e-6).floor().max(0.0);
            shape[axis] = count.min(f64::from(u32::MAX)) as u32;
            origin_m[axis] = low_m[axis] + 0.5 * (edge_m - (count - 1.0) * spacing_m);
        }
        Self::new(origin_m, spacing_m, shape)
    }

    /// The first point, in the world frame.
    pub fn origin_m(&self) -> Point3<f64> {
        self.origin_m
    }

    /// Distance between neighbouring points.
    pub fn spacing_m(&self) -> f64 {
        self.spacing_m
    }

    /// Points along x, y and z.
    pub fn shape(&self) -> [u32; 3] {
        self.shape
    }

    /// Number of points.
    pub fn n_cells(&self) -> u64 {
        self.shape.iter().map(|&n| u64::from(n)).product()
    }

    /// The cell at a place counted in cells along x, y and z.
    ///
    /// # Panics
    ///
    /// If the place lies outside the lattice, which is a bug in the caller.
    pub fn cell(&self, [i, j, k]: [u32; 3]) -> CellId {
        let [nx, ny, nz] = self.shape;
        assert!(i < nx && j < ny && k < nz, "cell ({i}, {j}, {k}) outside {:?}", self.shape);
        CellId(i + nx * (j + ny * k))
    }

    /// A cell's place, counted in cells along x, y and z.
    pub fn place(&self, cell: CellId) -> [u32; 3] {
        let [nx, ny, _] = self.shape;
        [cell.0 % nx, cell.0 / nx % ny, cell.0 / nx / ny]
    }

    /// Whether a cell number belongs to this lattice.
    pub fn contains(&self, cell: CellId) -> bool {
        u64::from(cell.0) < self.n_cells()
    }

    /// Whether a place, counted in cells, belongs to this lattice.
    pub(crate) fn holds(&self, place: [u32; 3]) -> bool {
        (0..3).all(|axis| place[axis] < self.shape[axis])
    }

    /// A cell's rest point, in the world frame.
    pub fn point(&self, cell: CellId) -> Point3<f64> {
        self.point_at(self.place(cell))
    }

    /// The rest point at a place counted in cells.
    pub fn point_at(&self, place: [u32; 3]) -> Point3<f64> {
        let steps = Vector3::from(place.map(f64::from));
        self.origin_m + steps * self.spacing_m
    }

    /// The cell whose rest point is nearest, or `None` outside the box.
    pub fn nearest(&self, point: &Point3<f64>) -> Option<CellId> {
        let steps = (point - self.origin_m) / self.spacing_m;
        let mut place = [0; 3];
        for axis in 0..3 {
            let rounded = steps[axis].round();
            if !(rounded >= 0.0 && rounded < f64::from(self.shape[axis])) {
                return None;
            }
            place[axis] = rounded as u32;
        }
        Some(self.cell(place))
    }

    /// The places, in cells, of the points inside an axis-aligned box: first and one past last.
    ///
    /// Empty along an axis (`first >= end`) when the box holds no point.
    pub fn places_within(&self, low: &Point3<f64>, high: &Point3<f64>) -> ([u32; 3], [u32; 3]) {
        let mut first = [0; 3];
        let mut end = [0; 3];
        for axis in 0..3 {
            let from = (low[axis] - self.origin_m[axis]) / self.spacing_m;
            let to = (high[axis] - self.origin_m[axis]) / self.spacing_m;
            let n = f64::from(self.shape[axis]);
            first[axis] = from.ceil().clamp(0.0, n) as u32;
            end[axis] = (to.floor() + 1.0).clamp(0.0, n) as u32;
        }
        (first, end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_is_the_nearest_to_its_own_point() {
        let lattice = Lattice::new([-0.3, 0.1, 0.0], 0.02, [7, 11, 5]).unwrap();
        for number in 0..lattice.n_cells() as u32 {
            let cell = CellId(number);
            assert_eq!(lattice.cell(lattice.place(cell)), cell);
            assert_eq!(lattice.nearest(&lattice.point(cell)), Some(cell));
        }
        assert_eq!(lattice.nearest(&Point3::new(-0.32, 0.1, 0.0)), None);
        assert_eq!(lattice.nearest(&Point3::new(f64::NAN, 0.1, 0.0)), None);
    }

    #[test]
    fn the_papers_box_has_eight_million_points_about_the_base() {
        let lattice = Lattice::default();
        assert_eq!(lattice.n_cells(), 8_000_000);
        let filled = Lattice::filling([-1.2; 3], [1.2; 3], 0.012).unwrap();
        assert_eq!(filled.shape(), lattice.shape());
        assert!((filled.origin_m() - lattice.origin_m()).norm() < 1e-12);
    }

    #[test]
    fn an_impossible_box_is_refused_with_its_numbers() {
        let spacing = Lattice::new([0.0; 3], 0.0, [2; 3]).unwrap_err();
        assert!(spacing.to_string().contains("spacing is 0 m"));
        assert!(Lattice::new([0.0; 3], f64::NAN, [2; 3]).is_err());
        assert!(Lattice::new([0.0; 3], 0.01, [2, 0, 2]).is_err());
        let large = Lattice::filling([-50.0; 3], [50.0; 3], 0.001).unwrap_err();
        assert!(matches!(large, LatticeError::TooManyPoints { .. }), "{large}");
        assert!(Lattice::new([0.0; 3], 0.01, [1000; 3]).is_ok());
    }

    #[test]
    fn places_within_a_box_are_those_whose_points_lie_in_it() {
        let lattice = Lattice::new([0.0; 3], 0.1, [10, 10, 10]).unwrap();
        let low = Point3::new(0.05, -1.0, 0.3);
        let high = Point3::new(0.4, 0.0, 99.0);
        let (first, end) = lattice.places_within(&low, &high);
        assert_eq!((first, end), ([1, 0, 3], [5, 1, 10]));
    }
}
