//! A field from arrays of another program, with the same checks as for a file.

use std::collections::HashSet;

use palpate::{Field, Lattice, MapperConfig};
use palpate_io::field::SavedField;

/// Arrays of N points with their springs.
#[derive(Debug, Clone)]
pub struct FieldArrays {
    /// Rest points, m, world frame.
    pub points_m: Vec<[f64; 3]>,
    /// Stiffness of the points, N/m.
    pub stiffness_n_per_m: Vec<f64>,
    /// Standard deviation of the stiffness, N/m.
    pub std_n_per_m: Vec<f64>,
    /// Number of frames that touched the point; 0 if its stiffness is a prior mean.
    pub counts: Vec<u32>,
    /// Stiffness of all other cells, N/m.
    pub untouched_n_per_m: f64,
}

/// What can be wrong with given arrays.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum FieldArraysError {
    /// Arrays of different lengths.
    #[error("`{name}` has {found} rows and `points` has {points}; wanted one for each point")]
    Length { name: &'static str, found: usize, points: usize },
    /// A number that makes no sense.
    #[error("`{name}` holds {found} in row {row} (from 0); wanted {wanted}")]
    Value { name: &'static str, row: usize, found: f64, wanted: &'static str },
    /// A point that is not a point of the lattice.
    #[error(
        "point {row} (from 0), {point_m:?} m, is no point of the lattice: {what}; give the lattice \
         of these points, or move them to the points of the lattice first"
    )]
    Off { row: usize, point_m: [f64; 3], what: String },
    /// Two springs at one point.
    #[error("point {row} (from 0), {point_m:?} m, comes twice; wanted each point once")]
    Twice { row: usize, point_m: [f64; 3] },
}

const SPRING: &str = "a finite number, not below 0";
/// Largest distance of a point from that of its cell, as a share of the spacing; rounding errors of
/// `f32` are smaller at a few metres.
const NEAR: f64 = 1e-3;

impl FieldArrays {
    /// The field of these arrays, with the lattice, contact model and torque convention of
    /// `config`.
    ///
    /// # Errors
    ///
    /// If arrays differ in length, a number is not finite or below 0, or a point is not one of the
    /// lattice's, or comes twice.
    pub fn field(self, config: &MapperConfig, robot: &str) -> Result<SavedField, FieldArraysError> {
        self.check()?;
        let lattice = &config.lattice;
        let mut taken = HashSet::new();
        let mut cells = Vec::with_capacity(self.points_m.len());
        for (row, &point_m) in self.points_m.iter().enumerate() {
            let cell = nearest(lattice, row, point_m)?;
            if !taken.insert(cell) {
                return Err(FieldArraysError::Twice { row, point_m });
            }
            cells.push(cell);
        }
        let (contact, touch) = (config.contact.clone(), config.touch.clone());
        let mut field = Field::new(lattice.clone(), contact, touch, self.untouched_n_per_m);
        (field.cells, field.counts) = (cells, self.counts);
        field.stiffness_n_per_m = self.stiffness_n_per_m;
        field.std_n_per_m = self.std_n_per_m;
        Ok(SavedField::of_field(field, robot))
    }

    fn check(&self) -> Result<(), FieldArraysError> {
        let points = self.points_m.len();
        let lengths = [
            ("stiffness", self.stiffness_n_per_m.len()),
            ("std", self.std_n_per_m.len()),
            ("counts", self.counts.len()),
        ];
        for (name, found) in lengths {
            if found != points {
                return Err(FieldArraysError::Length { name, found, points });
            }
        }
        let springs = [
            ("stiffness", self.stiffness_n_per_m.as_slice()),
            ("std", &self.std_n_per_m),
            ("untouched", std::slice::from_ref(&self.untouched_n_per_m)),
        ];
        for (name, numbers) in springs {
            let wrong = |number: &f64| !(number.is_finite() && *number >= 0.0);
            if let Some(row) = numbers.iter().position(wrong) {
                let found = numbers[row];
                return Err(FieldArraysError::Value { name, row, found, wanted: SPRING });
            }
        }
        Ok(())
    }
}

/// The cell of a point; `row` is its number, for errors.
fn nearest(
    lattice: &Lattice,
    row: usize,
    point_m: [f64; 3],
) -> Result<palpate::CellId, FieldArraysError> {
    let off = |what| FieldArraysError::Off { row, point_m, what };
    let cell = lattice.nearest(&point_m.into());
    let cell = cell.ok_or_else(|| off("it lies outside of the lattice".to_owned()))?;
    let gap_m = (lattice.point(cell) - nalgebra::Point3::from(point_m)).norm();
    if gap_m > NEAR * lattice.spacing_m() {
        return Err(off(format!("the nearest point of the lattice is {gap_m:.6} m away")));
    }
    Ok(cell)
}

#[cfg(test)]
mod tests {
    use palpate::EstimatorKind;

    use super::*;

    fn given() -> FieldArrays {
        let points = [[0.006, -0.006, 0.018], [0.006, 0.006, 0.018]];
        FieldArrays {
            points_m: points.to_vec(),
            stiffness_n_per_m: vec![3.0, 0.0],
            std_n_per_m: vec![1.0, 1.0],
            counts: vec![2, 0],
            untouched_n_per_m: 0.0,
        }
    }

    fn message(given: FieldArrays) -> String {
        given.field(&MapperConfig::of(EstimatorKind::Map), "arm").unwrap_err().to_string()
    }

    #[test]
    fn points_of_a_lattice_become_its_cells_in_their_order() {
        let saved = given().field(&MapperConfig::of(EstimatorKind::Map), "arm").unwrap();
        let points = saved.field.cells.iter().map(|&cell| saved.field.lattice.point(cell));
        for (found, wanted) in points.zip(given().points_m) {
            assert!((found - nalgebra::Point3::from(wanted)).norm() < 1e-9);
        }
        assert_eq!(saved.field.stiffness_n_per_m, given().stiffness_n_per_m);
    }

    #[test]
    fn wrong_values_are_named_with_their_row() {
        let mut wrong = given();
        wrong.stiffness_n_per_m[1] = f64::NAN;
        assert!(message(wrong).contains("`stiffness` holds NaN in row 1"));
        let mut wrong = given();
        wrong.counts.pop();
        assert!(message(wrong).contains("`counts` has 1 rows and `points` has 2"));
        let mut wrong = given();
        wrong.points_m[1] = wrong.points_m[0];
        assert!(message(wrong).contains("comes twice"));
        let mut wrong = given();
        wrong.points_m[0][2] += 0.002;
        assert!(message(wrong).contains("0.002000 m away"));
        let mut wrong = given();
        wrong.points_m[0][0] = 9.0;
        assert!(message(wrong).contains("outside"));
    }
}
