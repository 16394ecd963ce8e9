//! Content of a field file, converted from and to named arrays; every number is checked.

use palpate::{Field, Lattice};

use super::npz::{Array, Arrays, Data, NpzError};

/// Content of a field file.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldFile {
    /// Rest points, m, world frame.
    pub points: Vec<[f64; 3]>,
    /// Stiffness of each point, N/m.
    pub stiffness: Vec<f64>,
    /// Standard deviation of each stiffness, N/m.
    pub std: Option<Vec<f64>>,
    /// Number of frames that touched each point.
    pub counts: Option<Vec<u32>>,
    /// Prior mean of the stiffness of each point, N/m.
    pub prior: Option<Vec<f64>>,
    /// The lattice that the points belong to.
    pub lattice: Option<FieldLattice>,
    /// Index of each point in the lattice; every index occurs at most once.
    pub cells: Option<Vec<u32>>,
}

/// The lattice of a field file.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldLattice {
    /// First point of the lattice, m, world frame.
    pub origin_m: [f64; 3],
    /// Distance between neighbouring points, m.
    pub spacing_m: f64,
    /// Number of points along x, y and z.
    pub shape: [u32; 3],
}

impl From<&Field> for FieldFile {
    /// The lattice and the cells of a field, without prior means, which a [`Field`] does not contain.
    fn from(field: &Field) -> Self {
        Self {
            points: field.cells.iter().map(|&cell| field.lattice.point(cell).into()).collect(),
            stiffness: field.stiffness_n_per_m.clone(),
            std: Some(field.std_n_per_m.clone()),
            counts: Some(field.counts.clone()),
            prior: None,
            lattice: Some(FieldLattice::from(&field.lattice)),
            cells: Some(field.cells.iter().map(|cell| cell.0).collect()),
        }
    }
}

impl From<&Lattice> for FieldLattice {
    fn from(lattice: &Lattice) -> Self {
        let (origin_m, spacing_m) = (lattice.origin_m().into(), lattice.spacing_m());
        Self { origin_m, spacing_m, shape: lattice.shape() }
    }
}

impl FieldFile {
    /// Converts arrays and checks every number.
    ///
    /// # Errors
    ///
    /// If `points` or `K` is missing, or an array has a wrong type or shape, a number that is not finite, a stiffness
    /// below 0 or above 1e12 N/m, or a cell that is outside of the lattice or occurs twice.
    pub fn from_arrays(arrays: &Arrays) -> Result<Self, NpzError> {
        let points = arrays.floats("points", &[None, Some(3)])?.as_chunks::<3>().0.to_vec();
        let n = points.len();
        let stiffness = springs(arrays, "K", n)?;
        let std = given(arrays, "K_std").map(|name| springs(arrays, name, n)).transpose()?;
        let small = |name| arrays.small_counts(name, &[Some(n)]);
        let counts = given(arrays, "N_obs").map(small).transpose()?;
        let prior = given(arrays, "K_prior").map(|name| springs(arrays, name, n)).transpose()?;
        let lattice = given(arrays, "lattice").map(|_| lattice(arrays)).transpose()?;
        let cells = given(arrays, "cells").map(small).transpose()?;
        if let Some(cells) = &cells {
            check_cells(arrays, cells, lattice.as_ref())?;
        }
        Ok(Self { points, stiffness, std, counts, prior, lattice, cells })
    }

    /// The points whose stiffness exceeds a threshold, N/m.
    #[must_use]
    pub fn above(&self, stiffness_n_per_m: f64) -> Self {
        let is_kept: Vec<bool> = self.stiffness.iter().map(|&k| k > stiffness_n_per_m).collect();
        fn of<T: Copy>(values: &[T], is_kept: &[bool]) -> Vec<T> {
            values.iter().zip(is_kept).filter(|(_, kept)| **kept).map(|(value, _)| *value).collect()
        }
        let some = |values: &Option<Vec<f64>>| values.as_ref().map(|values| of(values, &is_kept));
        let counts = |values: &Option<Vec<u32>>| values.as_ref().map(|values| of(values, &is_kept));
        Self {
            points: of(&self.points, &is_kept),
            stiffness: of(&self.stiffness, &is_kept),
            std: some(&self.std),
            counts: counts(&self.counts),
            prior: some(&self.prior),
            lattice: self.lattice,
            cells: counts(&self.cells),
        }
    }

    /// Converts to arrays; others may be added to them.
    ///
    /// # Panics
    ///
    /// If the lists have different lengths.
    #[must_use]
    pub fn to_arrays(&self) -> Arrays {
        let n = self.points.len();
        let lattice = self.lattice.map(|FieldLattice { origin_m: [x, y, z], spacing_m, shape }| {
            let [nx, ny, nz] = shape.map(f64::from);
            Array::flat(Data::F64(vec![x, y, z, spacing_m, nx, ny, nz]))
        });
        let column = |data: Data| Array::new(vec![n], data);
        let floats = |column: &Vec<f64>| Data::F64(column.clone());
        let counts = |column: &Vec<u32>| Data::U32(column.clone());
        let points = Data::F64(self.points.as_flattened().to_vec());
        let mut arrays = Arrays::new();
        for (name, array) in [
            ("points", Some(Array::new(vec![n, 3], points))),
            ("K", Some(column(floats(&self.stiffness)))),
            ("K_std", self.std.as_ref().map(floats).map(column)),
            ("N_obs", self.counts.as_ref().map(counts).map(column)),
            ("K_prior", self.prior.as_ref().map(floats).map(column)),
            ("lattice", lattice),
            ("cells", self.cells.as_ref().map(counts).map(column)),
        ] {
            array.into_iter().for_each(|array| arrays.insert(name, array));
        }
        arrays
    }

    /// The numbers of each point with the names of their arrays: `K`, then `K_std` and `N_obs` if
    /// there are any.
    #[must_use]
    pub fn columns(&self) -> Vec<(&'static str, Vec<f64>)> {
        let as_floats = |counts: &Vec<u32>| counts.iter().copied().map(f64::from).collect();
        let counts: Option<Vec<f64>> = self.counts.as_ref().map(as_floats);
        let mut columns = vec![("K", self.stiffness.clone())];
        columns.extend(self.std.clone().map(|std| ("K_std", std)));
        columns.extend(counts.map(|counts| ("N_obs", counts)));
        columns
    }
}

/// The name, if there is an array with this name.
fn given<'a>(arrays: &Arrays, name: &'a str) -> Option<&'a str> {
    arrays.get(name).map(|_| name)
}

/// Largest stiffness of a point, N/m; a file with a larger one is refused. A steel rod of 1 cm has about 1e8 N/m.
const STIFFEST_N_PER_M: f64 = 1e12;

/// `n` numbers from 0 to [`STIFFEST_N_PER_M`]; the shape may also be n x 1, which OpenVSF may write.
pub(super) fn springs(arrays: &Arrays, name: &str, n: usize) -> Result<Vec<f64>, NpzError> {
    let is_column = arrays.get(name).is_some_and(|array| array.shape() == [n, 1]);
    let shape: &[_] = if is_column { &[Some(n), Some(1)] } else { &[Some(n)] };
    let numbers = arrays.floats(name, shape)?;
    arrays.check(name, &numbers, "numbers from 0 to 1e12", |number| {
        (0.0..=STIFFEST_N_PER_M).contains(&number)
    })?;
    Ok(numbers)
}

fn lattice(arrays: &Arrays) -> Result<FieldLattice, NpzError> {
    let numbers = arrays.floats("lattice", &[Some(7)])?;
    let refused = |row: usize, wanted| Err(arrays.refused("lattice", row, numbers[row], wanted));
    if numbers[3] <= 0.0 {
        return refused(3, "a spacing above 0");
    }
    let mut shape = [0; 3];
    for (axis, side) in shape.iter_mut().enumerate() {
        let given = numbers[4 + axis];
        if given < 1.0 || given.fract() != 0.0 || given > f64::from(u32::MAX) {
            return refused(4 + axis, "a whole number of points on each axis, at least 1");
        }
        *side = given as u32;
    }
    Ok(FieldLattice {
        origin_m: [numbers[0], numbers[1], numbers[2]],
        spacing_m: numbers[3],
        shape,
    })
}

/// Refuses cells that are outside of the lattice or occur twice.
fn check_cells(
    arrays: &Arrays,
    cells: &[u32],
    lattice: Option<&FieldLattice>,
) -> Result<(), NpzError> {
    let size = lattice.map_or(u128::MAX, |lattice| {
        lattice.shape.iter().map(|&side| u128::from(side)).product() // at most 96 bits
    });
    let outside = cells.iter().position(|&cell| u128::from(cell) >= size);
    if let Some(row) = outside {
        let wanted = "indices of cells within the lattice";
        return Err(arrays.refused("cells", row, f64::from(cells[row]), wanted));
    }
    let mut rows: Vec<usize> = (0..cells.len()).collect();
    rows.sort_by_key(|&row| (cells[row], row));
    match rows.array_windows().find(|[a, b]| cells[*a] == cells[*b]) {
        None => Ok(()),
        Some(&[_, row]) => {
            Err(arrays.refused("cells", row, f64::from(cells[row]), "each cell once"))
        }
    }
}
