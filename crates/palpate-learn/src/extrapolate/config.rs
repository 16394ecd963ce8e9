//! Settings of the extrapolation.

use palpate::Lattice;
use serde::Serialize;

use super::error::ExtrapolateError;
use super::features::Features;

/// Method of the extrapolation.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ExtrapolationMethod {
    /// A Gaussian process over features, learnt from torques.
    #[default]
    Torque,
    /// A Gaussian process over features, learnt from the stiffness of touched cells.
    Cells,
    /// The paper's method: the nearest neighbours among touched points.
    Knn,
}

impl ExtrapolationMethod {
    /// The name of the method in settings and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Torque => "torque",
            Self::Cells => "cells",
            Self::Knn => "knn",
        }
    }
}

/// The smallest and the largest [`ExtrapolationConfig::reach_cells`].
pub const REACH_CELLS: [f64; 2] = [0.5, 4.0];

/// Settings of the extrapolation.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ExtrapolationConfig {
    /// The method.
    pub method: ExtrapolationMethod,
    /// Features by which points are compared.
    pub features: Features,
    /// Largest distance of a cell from a seen point at which the point gives its stiffness, in
    /// cells.
    pub reach_cells: f64,
    /// Length scale of the Gaussian process, in standard deviations of the features over the cloud;
    /// used by `torque` and `cells`.
    pub length_scale: f64,
    /// Prior standard deviation of the stiffness, N/m for a cell of 1 cm; it is scaled with the
    /// volume of the cell.
    pub std_n_per_m: f64,
    /// Torque noise of a touch, of which all frames together count as one, N·m; used by `torque`.
    pub torque_std: f64,
    /// Number of neighbours; used by `knn`.
    pub neighbours: u32,
    /// Length scale of the neighbours' RBF kernel, in standard deviations of the features; used by
    /// `knn`.
    pub neighbour_scale: f64,
}

impl Default for ExtrapolationConfig {
    fn default() -> Self {
        Self {
            method: ExtrapolationMethod::default(),
            features: Features::default(),
            reach_cells: 1.25,
            length_scale: 2.0,
            std_n_per_m: 0.6,
            torque_std: 0.4,
            neighbours: 50,
            neighbour_scale: 0.5,
        }
    }
}

impl ExtrapolationConfig {
    /// Checks every setting against its range.
    ///
    /// # Errors
    ///
    /// Names the first setting out of range.
    pub fn check(&self) -> Result<(), ExtrapolateError> {
        let reach = ("from 0.5 to 4", REACH_CELLS[0]..=REACH_CELLS[1]);
        let any = ("from 1e-6 to 1e6", 1e-6..=1e6);
        for (setting, found, (wanted, range)) in [
            ("reach_cells", self.reach_cells, &reach),
            ("length_scale", self.length_scale, &any),
            ("std_n_per_m", self.std_n_per_m, &any),
            ("torque_std", self.torque_std, &any),
            ("neighbours", f64::from(self.neighbours), &any),
            ("neighbour_scale", self.neighbour_scale, &any),
        ] {
            if !range.contains(&found) {
                return Err(ExtrapolateError::Setting { setting, found, wanted });
            }
        }
        Ok(())
    }

    /// [`ExtrapolationConfig::reach_cells`] in m.
    pub fn reach_m(&self, lattice: &Lattice) -> f64 {
        self.reach_cells * lattice.spacing_m()
    }

    /// Prior standard deviation of the stiffness of a cell of this lattice, N/m.
    pub(super) fn prior_std(&self, lattice: &Lattice) -> f64 {
        self.std_n_per_m * (lattice.spacing_m() / 0.01).powi(3)
    }
}
