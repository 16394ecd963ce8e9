//! The belief of both estimators: unknown, variance and count of every cell, by row.

use nalgebra::{DMatrix, DVector};

use super::{EstimatorConfig, EstimatorError, EstimatorState, LARGEST, RememberedFrame};
use crate::replay::RngState;
use crate::torque::{CellState, Observation};

/// A diagonal Gaussian over the cells' unknowns: z of `map`, κ of `ekf`.
///
/// Rows without a stored value have the prior.
#[derive(Debug, Clone)]
pub(crate) struct Belief {
    /// Prior mean (N/m) and variance ((N/m)²) of a cell at this lattice's spacing.
    pub(crate) prior_mean: f64,
    pub(crate) prior_variance: f64,
    /// The diagonal of R, n_joints, (N·m)².
    pub(crate) torque_variance: DVector<f64>,
    /// Rest points and unknowns, by row.
    pub(crate) cells: Vec<CellState>,
    /// Variances of the unknowns, (N/m)², by row.
    pub(crate) variance: Vec<f64>,
    /// Number of frames that touched the cell, by row.
    counts: Vec<u32>,
    /// Number of steps so far.
    pub(crate) step: u64,
}

impl Belief {
    /// A belief without rows: the prior, for cells of this spacing and a robot of `n_joints`.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range.
    pub(crate) fn new(
        config: &EstimatorConfig,
        spacing_m: f64,
        n_joints: usize,
    ) -> Result<Self, EstimatorError> {
        let torque_variance = config.torque_variance(n_joints)?;
        let (prior_mean, prior_std) = config.prior.at_spacing(spacing_m);
        Ok(Self {
            prior_mean,
            prior_variance: prior_std * prior_std,
            torque_variance,
            cells: Vec::new(),
            variance: Vec::new(),
            counts: Vec::new(),
            step: 0,
        })
    }

    /// Adds new rows with the prior; `points_m` are the rest points of all rows, world frame.
    pub(crate) fn grow(&mut self, points_m: &[[f64; 3]]) {
        let known = self.cells.len().min(points_m.len());
        self.cells
            .extend(points_m[known..].iter().map(|&point| CellState::new(point, self.prior_mean)));
        self.fill();
    }

    /// Adds new rows with their own prior means, N/m; means below `least` are raised to it.
    pub(crate) fn set_prior_means(
        &mut self,
        points_m: &[[f64; 3]],
        mean_n_per_m: &[f64],
        least: f64,
    ) {
        assert!(mean_n_per_m.len() <= points_m.len(), "a row with a prior mean has a rest point");
        let valid = |mean: &f64| (0.0..=LARGEST).contains(mean);
        assert!(mean_n_per_m.iter().all(valid), "a prior mean is a stiffness");
        let rows = points_m.iter().zip(mean_n_per_m).skip(self.cells.len());
        self.cells.extend(rows.map(|(&point, &mean)| CellState::new(point, mean.max(least))));
        self.fill();
    }

    /// Extends the other arrays to the rows of `cells`.
    fn fill(&mut self) {
        self.variance.resize(self.cells.len(), self.prior_variance);
        self.counts.resize(self.cells.len(), 0);
    }

    /// The unknown of a row, N/m.
    pub(crate) fn unknown(&self, row: usize) -> f64 {
        self.cells.get(row).map_or(self.prior_mean, CellState::unknown)
    }

    /// The variance of a row, (N/m)².
    pub(crate) fn variance(&self, row: usize) -> f64 {
        self.variance.get(row).copied().unwrap_or(self.prior_variance)
    }

    /// Number of frames that touched a row.
    pub(crate) fn count(&self, row: usize) -> u32 {
        self.counts.get(row).copied().unwrap_or(0)
    }

    /// Counts one more frame for each cell that it touches.
    pub(crate) fn count_contacts(&mut self, observation: &Observation) {
        observation.rows().for_each(|row| self.counts[row] += 1);
    }

    /// The Kalman update of the variances of a frame's cells, `Pᵢ − Pᵢ² wᵢᵀ C⁻¹ wᵢ` with C = H P Hᵀ + R. The result is
    /// positive in spite of rounding.
    pub(crate) fn shrink(&mut self, observation: &Observation, inverse: &DMatrix<f64>) {
        let variance = &mut self.variance;
        observation.quadratic(&self.cells, inverse, |row, value| {
            variance[row] *= (1.0 - variance[row] * value).max(f64::EPSILON);
        });
    }

    /// `√ diag(H P Hᵀ)`, n_joints, N·m, for a diagonal P, given by row.
    pub(crate) fn band_spread(
        &self,
        observation: &Observation,
        variance: impl Fn(usize) -> f64,
    ) -> DVector<f64> {
        observation.torque_std(&self.cells, variance)
    }

    /// `C⁻¹ = (H P Hᵀ + R)⁻¹`, the inverse of the innovation covariance, for a diagonal P, given by row.
    ///
    /// # Errors
    ///
    /// If C is not positive definite, or its inverse is not finite.
    pub(crate) fn innovation_inverse(
        &self,
        observation: &Observation,
        variance: impl Fn(usize) -> f64,
    ) -> Result<DMatrix<f64>, EstimatorError> {
        let mut covariance = observation.weighted_gram(&self.cells, variance);
        for (joint, variance) in self.torque_variance.iter().enumerate() {
            covariance[(joint, joint)] += variance;
        }
        let inverse = covariance.cholesky().ok_or(EstimatorError::Degenerate)?.inverse();
        let is_finite = inverse.iter().all(|x| x.is_finite());
        is_finite.then_some(inverse).ok_or(EstimatorError::Degenerate)
    }

    /// The state to be saved, with `n_rows` rows; rows without a stored value have the prior.
    pub(crate) fn state(
        &self,
        n_rows: usize,
        remembered: Vec<RememberedFrame>,
        rng: RngState,
    ) -> EstimatorState {
        let means: Vec<f64> = self.cells.iter().map(CellState::unknown).collect();
        EstimatorState {
            mean: padded(&means, n_rows, self.prior_mean),
            variance: padded(&self.variance, n_rows, self.prior_variance),
            counts: padded(&self.counts, n_rows, 0),
            seen: Vec::new(),
            step: self.step,
            remembered,
            rng,
        }
    }

    /// Restores a saved state; `points_m` are the rest points of all rows, world frame.
    ///
    /// # Errors
    ///
    /// If the state contradicts itself.
    pub(crate) fn restore(
        &mut self,
        state: &EstimatorState,
        points_m: &[[f64; 3]],
    ) -> Result<(), EstimatorError> {
        state.check(points_m.len(), self.torque_variance.len())?;
        self.grow(points_m);
        for (cell, mean) in self.cells.iter_mut().zip(&state.mean) {
            *cell.unknown_mut() = *mean;
        }
        self.variance[..state.variance.len()].copy_from_slice(&state.variance);
        self.counts[..state.counts.len()].copy_from_slice(&state.counts);
        self.step = state.step;
        Ok(())
    }
}

/// A copy of values by row, extended to `n_rows` rows with `fill`.
pub(crate) fn padded<T: Copy>(values: &[T], n_rows: usize, fill: T) -> Vec<T> {
    let mut padded = values.to_vec();
    padded.resize(n_rows.max(values.len()), fill);
    padded
}
