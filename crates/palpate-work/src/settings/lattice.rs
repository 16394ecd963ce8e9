//! The workspace box: makes lattices from settings, compares them, and describes them in words.

use palpate::{Lattice, LatticeError};

use super::error::SettingsError;
use super::sections::LatticeSettings;

impl LatticeSettings {
    /// Whether the box is given by its corners.
    pub(super) fn by_box(&self) -> bool {
        self.box_low_m.is_some() || self.box_high_m.is_some()
    }

    /// Whether the box is given by its first point and its numbers of points.
    pub(super) fn by_shape(&self) -> bool {
        self.origin_m.is_some() || self.shape.is_some()
    }

    /// Whether a box with the given corner can have this lattice, if only one corner is given.
    ///
    /// A lattice is centred in its box, so the other corner is the mirror image of the given one.
    pub(super) fn may_give(&self, saved: &Lattice) -> bool {
        let (low_m, high_m) = corners(saved);
        let mirrored = |corner_m: [f64; 3]| {
            std::array::from_fn(|axis| low_m[axis] + high_m[axis] - corner_m[axis])
        };
        let (low_m, high_m) = match (self.box_low_m, self.box_high_m) {
            (Some(low_m), None) => (low_m, mirrored(low_m)),
            (None, Some(high_m)) => (mirrored(high_m), high_m),
            _ => return false, // Both corners are given, or none.
        };
        let spacing_m = self.spacing_m.unwrap_or(saved.spacing_m());
        !self.by_shape()
            && Lattice::filling(low_m, high_m, spacing_m)
                .is_ok_and(|lattice| same_lattice(&lattice, saved))
    }

    /// The lattice of these settings; values that are not given are those of `base`.
    pub(super) fn over_lattice(&self, base: &Lattice) -> Result<Lattice, SettingsError> {
        let spacing_m = self.spacing_m.unwrap_or(base.spacing_m());
        if self.by_box() && self.by_shape() {
            return Err(SettingsError::Together(
                "the lattice is given twice; give either box_low_m and box_high_m, or origin_m \
                 and shape"
                    .to_owned(),
            ));
        }
        if self.by_shape() {
            let origin_m = self.origin_m.unwrap_or(base.origin_m().into());
            return Ok(Lattice::new(origin_m, spacing_m, self.shape.unwrap_or(base.shape()))?);
        }
        if !self.by_box() && spacing_m == base.spacing_m() {
            return Ok(base.clone());
        }
        let (low_m, high_m) = corners(base);
        let (low_m, high_m) = (self.box_low_m.unwrap_or(low_m), self.box_high_m.unwrap_or(high_m));
        if (0..3).any(|axis| high_m[axis] <= low_m[axis]) {
            return Err(SettingsError::Together(format!(
                "the workspace box is turned inside out: box_high_m is {high_m:?}, which must be \
                 above box_low_m, {low_m:?}, on every axis"
            )));
        }
        let lattice = Lattice::filling(low_m, high_m, spacing_m).map_err(|error| match error {
            LatticeError::EmptyAxis { .. } => SettingsError::Together(format!(
                "a spacing of {spacing_m} m leaves no point in the box from {low_m:?} to \
                 {high_m:?} m; make the spacing smaller or the box larger"
            )),
            other => SettingsError::Lattice(other),
        })?;
        Ok(lattice)
    }
}

/// The corners of the box that a lattice fills, m.
pub fn corners(lattice: &Lattice) -> ([f64; 3], [f64; 3]) {
    let (spacing_m, shape) = (lattice.spacing_m(), lattice.shape());
    let low_m: [f64; 3] = lattice.origin_m().coords.map(|x| x - 0.5 * spacing_m).into();
    let high_m =
        std::array::from_fn(|axis| low_m[axis] + f64::from(shape[axis]) * lattice.spacing_m());
    (low_m, high_m)
}

/// Whether two lattices are equal up to rounding errors.
pub(crate) fn same_lattice(a: &Lattice, b: &Lattice) -> bool {
    (a.spacing_m() - b.spacing_m()).abs() < 1e-9
        && (a.origin_m() - b.origin_m()).amax() < 1e-9
        && a.shape() == b.shape()
}

/// Shape, spacing and origin of a lattice in words.
pub(crate) fn lattice_in_words(lattice: &Lattice) -> String {
    let origin_m: [f64; 3] = lattice.origin_m().into();
    format!("{:?} points every {} m from {origin_m:?} m", lattice.shape(), lattice.spacing_m())
}
