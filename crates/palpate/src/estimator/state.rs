//! State of an estimator, to be saved and restored.

use serde::{Deserialize, Serialize};

use super::EstimatorError;
use crate::replay::RngState;

/// Identity of a frame: which sample of which touch it was.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct FrameId {
    /// Number of the touch, counted from the first touch of the mapper.
    pub touch: u32,
    /// Number of the sample in its touch.
    pub sample: u32,
}

/// A remembered frame, without its observation.
#[derive(Debug, Clone, PartialEq)]
pub struct RememberedFrame {
    /// Identity of the frame.
    pub id: FrameId,
    /// `map`: its multipliers α, n_joints; else empty.
    pub alpha: Vec<f64>,
    /// `map`: its normalised innovation squared at its last visit; else 0.
    pub nis: f64,
}

/// State of an estimator; the observations of its remembered frames are not included.
#[derive(Debug, Clone, PartialEq)]
pub struct EstimatorState {
    /// z of `map` or the mean of κ of `ekf`, by row, N/m.
    pub mean: Vec<f64>,
    /// Variance by row, (N/m)².
    pub variance: Vec<f64>,
    /// Number of frames that touched the cell, by row.
    pub counts: Vec<u32>,
    /// `ekf`: the step up to which the variance includes the drift, by row; empty for `map`.
    pub seen: Vec<u64>,
    /// Number of steps so far.
    pub step: u64,
    /// Remembered frames, in the order of the memory.
    pub remembered: Vec<RememberedFrame>,
    /// State of the random generator of the draws from memory.
    pub rng: RngState,
}

impl EstimatorState {
    /// Checks that all arrays have the same number of rows, at most `n_rows`, and finite numbers.
    pub(super) fn check(&self, n_rows: usize, n_joints: usize) -> Result<(), EstimatorError> {
        let rows = self.mean.len();
        let agree = self.variance.len() == rows && self.counts.len() == rows && rows <= n_rows;
        if !agree || !(self.seen.is_empty() || self.seen.len() == rows) {
            let what = format!(
                "{n_rows} cells, but {rows} means, {} variances, {} counts and {} last steps",
                self.variance.len(),
                self.counts.len(),
                self.seen.len()
            );
            return Err(EstimatorError::State { what });
        }
        let alphas = self.remembered.iter().map(|frame| frame.alpha.len());
        if let Some(got) = alphas.clone().find(|&n| n != n_joints && n != 0) {
            let what = format!("a frame has {got} multipliers for {n_joints} joints");
            return Err(EstimatorError::State { what });
        }
        let frames =
            self.remembered.iter().flat_map(|frame| frame.alpha.iter().chain([&frame.nis]));
        let mut numbers = self.mean.iter().chain(&self.variance).chain(frames);
        if numbers.any(|x| !x.is_finite()) || self.variance.iter().any(|v| *v < 0.0) {
            let what = "a mean, variance, multiplier or innovation is not a finite number";
            return Err(EstimatorError::State { what: what.to_owned() });
        }
        Ok(())
    }
}
