//! The common parts of the two estimators: their interface, prior and saved state.
//!
//! An estimator holds a belief about the stiffness of every touched cell, by row. [`crate::map`] is the exact maximum a
//! posteriori, [`crate::ekf`] the paper's filter. Estimators depend neither on the robot nor on the lattice: they get
//! rest points by row, and contacts as [`Observation`]s.

mod belief;
mod state;

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

pub(crate) use self::belief::{Belief, padded};
pub use self::state::{EstimatorState, FrameId, RememberedFrame};
use crate::replay::MemoryLimits;
use crate::setting::SettingError;
use crate::torque::Observation;

/// The stiffness of a cell before it is touched, stated for a reference cell of 1 cm.
///
/// A field of springs with spacing h represents an elastic medium: the mean is proportional to the volume of a cell
/// (h³), and the standard deviation is that of white noise in space (h^1.5). So one prior is valid for every
/// resolution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prior {
    /// Mean of a cell of 1 cm, N/m.
    pub mean_n_per_m: f64,
    /// Standard deviation of a cell of 1 cm, N/m.
    pub std_n_per_m: f64,
}

impl Prior {
    /// Mean (N/m) and standard deviation (N/m) of a cell at this spacing.
    pub fn at_spacing(&self, spacing_m: f64) -> (f64, f64) {
        let ratio = spacing_m / 0.01;
        (self.mean_n_per_m * ratio.powi(3), self.std_n_per_m * ratio.powf(1.5))
    }
}

/// What can be wrong with an estimator's settings, a measurement or a saved state.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum EstimatorError {
    /// A setting outside its range.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// At κ = 0 the slope of |κ| is undefined, and the paper's filter does not leave it.
    #[error(
        "the prior mean of `ekf` is 0 N/m, where the slope of |κ| is undefined and the paper's filter \
         never learns; give it a small positive prior mean"
    )]
    EkfPriorMeanZero,
    /// Neither one torque noise for each joint nor one for all.
    #[error("torque_std has {got} values; give one for all joints or one for each of {expected}")]
    TorqueStdCount { got: usize, expected: usize },
    /// An innovation covariance that overflows or is not positive definite.
    #[error(
        "the measurement cannot be used: its innovation covariance is not a finite, positive matrix"
    )]
    Degenerate,
    /// A saved state that contradicts itself.
    #[error("the saved state is inconsistent: {what}")]
    State { what: String },
}

/// Choice of the estimator.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EstimatorKind {
    /// The exact maximum a posteriori ([`crate::unstable::MapEstimator`]).
    #[default]
    Map,
    /// The paper's filter ([`crate::unstable::EkfEstimator`]).
    Ekf,
    /// In a [`crate::Mapper`] the same as [`Self::Map`]; palpate-learn also fits an elastic body
    /// ([`crate::unstable::ElasticModel`]) to the touches.
    Elastic,
}

impl EstimatorKind {
    /// All estimators.
    pub const ALL: [Self; 3] = [Self::Map, Self::Ekf, Self::Elastic];

    /// Its name in settings, files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Map => "map",
            Self::Ekf => "ekf",
            Self::Elastic => "elastic",
        }
    }
}

/// Estimate of one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct CellEstimate {
    /// K, N/m.
    pub stiffness_n_per_m: f64,
    /// Standard deviation of K, N/m.
    pub std_n_per_m: f64,
    /// Number of frames that touched the cell.
    pub count: u32,
}

/// Bounds of every mean and standard deviation, N/m or N·m. Real values lie within them, and products of values within
/// them do not overflow.
const SMALLEST: f64 = 1e-9;
pub(crate) const LARGEST: f64 = 1e9;

/// Settings of an estimator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct EstimatorConfig {
    /// Stiffness of untouched cells.
    pub prior: Prior,
    /// σ_τ, N·m: one value for all joints, or one per joint. It covers all errors of the model, not only the noise of
    /// the sensor.
    pub torque_std: Vec<f64>,
    /// Factor, 0 to 1, on all K, learnt or prior, that are returned or used in predictions; only for `map`. Below 1 if
    /// predictions of touches that were not learnt are too large.
    #[serde(default = "unscaled")]
    pub stiffness_scale: f64,
    /// Number of replays after each new frame.
    pub replays: u32,
    /// Standard deviation of the drift ε of Eq. 4, N/m per step for a cell of 1 cm; only for `ekf`. 0 by default:
    /// objects do not change.
    pub drift_std_n_per_m: f64,
    /// Limits of the memory of frames.
    pub memory: MemoryLimits,
    /// Seed of the random draws from memory.
    pub seed: u64,
}

/// Default of `stiffness_scale` for files without it.
fn unscaled() -> f64 {
    1.0
}

impl EstimatorConfig {
    /// The default settings of an estimator.
    pub fn of(method: EstimatorKind) -> Self {
        let (mean_n_per_m, torque_std) = match method {
            EstimatorKind::Map | EstimatorKind::Elastic => (0.0, 0.2),
            // Each replay counts a measurement again, which a larger noise compensates.
            EstimatorKind::Ekf => (0.006, 1.5),
        };
        Self {
            prior: Prior { mean_n_per_m, std_n_per_m: 0.76 },
            torque_std: vec![torque_std],
            stiffness_scale: 1.0,
            replays: 20,
            drift_std_n_per_m: 0.0,
            memory: MemoryLimits { frames: 20_000, bytes: 256 << 20 },
            seed: 0,
        }
    }

    /// Checks every setting that is a number against its range.
    ///
    /// # Errors
    ///
    /// Names the first setting out of range.
    pub fn check(&self) -> Result<(), SettingError> {
        let (check, prior) = (SettingError::check, &self.prior);
        check("prior_mean", prior.mean_n_per_m, 0.0..=LARGEST, "from 0 to 1e9 N/m")?;
        check("drift_std", self.drift_std_n_per_m, 0.0..=LARGEST, "from 0 to 1e9 N/m")?;
        check("prior_std", prior.std_n_per_m, SMALLEST..=LARGEST, "from 1e-9 to 1e9 N/m")?;
        check("stiffness_scale", self.stiffness_scale, 0.0..=1.0, "from 0 to 1")?;
        for &std in &self.torque_std {
            check("torque_std", std, SMALLEST..=LARGEST, "from 1e-9 to 1e9 N·m")?;
        }
        Ok(())
    }

    /// R's diagonal, (N·m)², n_joints.
    ///
    /// # Errors
    ///
    /// As [`Self::check`], or if there is neither one standard deviation of the torque nor one for each joint.
    pub fn torque_variance(&self, n_joints: usize) -> Result<DVector<f64>, EstimatorError> {
        self.check()?;
        if self.torque_std.len() != 1 && self.torque_std.len() != n_joints {
            let got = self.torque_std.len();
            return Err(EstimatorError::TorqueStdCount { got, expected: n_joints });
        }
        let std = |joint: usize| self.torque_std[joint.min(self.torque_std.len() - 1)];
        Ok(DVector::from_fn(n_joints, |joint, _| std(joint).powi(2)))
    }
}

/// Number of frames and contacts that were replayed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Replayed {
    /// Replayed frames; 0 if no frame is remembered.
    pub frames: u32,
    /// Contacts of these frames.
    pub contacts: u64,
}

impl Replayed {
    /// Counts one more frame.
    pub(crate) fn add(&mut self, observation: &Observation) {
        self.frames += 1;
        self.contacts += observation.n_contacts() as u64;
    }
}

/// A belief about the stiffness of touched cells that learns from frames.
///
/// Rows that no frame has touched have the prior of the settings, unless they have their own prior mean.
pub trait Estimator: Send + Sync {
    /// K of a row, N/m, at least zero.
    fn stiffness(&self, row: usize) -> f64;

    /// Standard deviation of a row, N/m; its meaning is documented with each estimator.
    fn std(&self, row: usize) -> f64;

    /// Number of frames that touched a row.
    fn count(&self, row: usize) -> u32;

    /// The estimate of a row; for a row that does not exist, such as `usize::MAX`, the prior.
    fn estimate(&self, row: usize) -> CellEstimate {
        CellEstimate {
            stiffness_n_per_m: self.stiffness(row),
            std_n_per_m: self.std(row),
            count: self.count(row),
        }
    }

    /// The estimates of the first `rows` rows, in one call because a query waits for it.
    fn estimates(&self, rows: usize) -> Vec<CellEstimate> {
        (0..rows).map(|row| self.estimate(row)).collect()
    }

    /// Gives untouched rows their own prior mean, m₀ by row.
    ///
    /// Rows that a frame has touched keep their estimate; rows after the given ones have the prior mean
    /// of the settings. The prior's standard deviation is the same for every row. `ekf` cannot leave
    /// κ = 0, so there a mean below the settings' prior mean is raised to it.
    ///
    /// `points_m` are the rest points of at least as many rows, world frame; `mean_n_per_m` are
    /// their means, N/m.
    ///
    /// # Panics
    ///
    /// If a mean has no point, is negative or not finite, which is a bug in the caller.
    fn set_prior_means(&mut self, points_m: &[[f64; 3]], mean_n_per_m: &[f64]);

    /// Predicts a new frame, `τ̂ = H K` (Eq. 5), n_joints, N·m, without learning from it; `points_m` as for
    /// [`Estimator::correct`].
    fn predict(&mut self, points_m: &[[f64; 3]], observation: &Observation) -> DVector<f64>;

    /// Predicts a new frame, learns from it and remembers it; returns the prediction, `τ̂ = H K`
    /// before the correction (Eq. 5), n_joints, N·m.
    ///
    /// `points_m` are the rest points by row ([`crate::lattice::CellRows::points_m`]), world frame.
    ///
    /// # Errors
    ///
    /// If the frame's numbers cannot be used; the belief is then as before.
    fn correct(
        &mut self,
        points_m: &[[f64; 3]],
        observation: Observation,
        frame_id: FrameId,
    ) -> Result<DVector<f64>, EstimatorError>;

    /// s of [`Calibration::half_width`](crate::Calibration::half_width) for a frame before it is learnt, n_joints, N·m;
    /// `relative_std` is ρ, and `points_m` as for [`Estimator::correct`].
    fn band_spread(
        &mut self,
        points_m: &[[f64; 3]],
        observation: &Observation,
        relative_std: f64,
    ) -> DVector<f64>;

    /// Advances by one step without contact: with drift (Eq. 4), variances grow.
    fn advance_time(&mut self);

    /// Fuses remembered frames again, as many as `visits`, drawn from memory.
    fn replay(&mut self, visits: u32) -> Replayed;

    /// Condenses the frames of a touch: they are removed from memory and replayed no more; what was learnt from them
    /// stays in the belief.
    fn condense(&mut self, touch: u32);

    /// Identities of the remembered frames, in the order of the memory.
    fn frame_ids(&self) -> Vec<FrameId>;

    /// Residual τ − τ̂ and torque τ of about `most` evenly chosen remembered frames, n_joints each, N·m, times the
    /// weight of each torque ([`Observation::weighted`]).
    fn errors(&self, most: usize) -> Vec<(FrameId, [DVector<f64>; 2])>;

    /// Bytes of the remembered frames.
    fn memory_bytes(&self) -> usize;

    /// The state to be saved, with `n_rows` rows.
    fn state(&self, n_rows: usize) -> EstimatorState;

    /// Restores a saved state, given the rest points of all rows (world frame, m) and the observations of the
    /// remembered frames, in the order of the state. Called on an estimator that has learnt nothing yet.
    ///
    /// # Errors
    ///
    /// If the state contradicts itself or the observations.
    fn restore(
        &mut self,
        state: &EstimatorState,
        points_m: &[[f64; 3]],
        observations: Vec<Observation>,
    ) -> Result<(), EstimatorError>;
}
