//! What the two estimators have in common: their interface, prior and saved state.
//!
//! An estimator holds a belief about the stiffness of every touched cell, by row. [`crate::map`]
//! is the exact maximum a posteriori, [`crate::ekf`] the paper's filter. Neither knows the robot
//! or the lattice beyond its rest points; contacts come as [`Observation`]s.

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
/// A field of springs with spacing h stands for an elastic bed: the mean is spread over volume
/// (h³), the standard deviation is that of white noise in space (h^1.5). So one prior serves
/// every resolution.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prior {
    /// Mean of a cell of 1 cm, N/m.
    pub mean_n_per_m: f64,
    /// Standard deviation of a cell of 1 cm, N/m.
    pub std_n_per_m: f64,
}

impl Prior {
    /// Mean (N/m) and standard deviation (N/m) of a cell of another size.
    pub fn at_spacing(&self, spacing_m: f64) -> (f64, f64) {
        let ratio = spacing_m / 0.01;
        (self.mean_n_per_m * ratio.powi(3), self.std_n_per_m * ratio.powf(1.5))
    }
}

/// What can be wrong with an estimator's settings, or with what it is asked to learn from.
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
    /// One torque noise a joint, or one for all.
    #[error("torque_std has {got} values; give one for all joints or one for each of {expected}")]
    TorqueStdCount { got: usize, expected: usize },
    /// Torques or levers beyond what numbers can hold.
    #[error(
        "the measurement cannot be used: its innovation covariance is not a finite, positive matrix"
    )]
    Degenerate,
    /// A saved state that contradicts itself.
    #[error("the saved state is inconsistent: {what}")]
    State { what: String },
}

/// Which estimator learns.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum EstimatorKind {
    /// The exact maximum a posteriori ([`crate::unstable::MapEstimator`]).
    #[default]
    Map,
    /// The paper's filter ([`crate::unstable::EkfEstimator`]).
    Ekf,
    /// [`Self::Map`] for a [`crate::Mapper`]; palpate-learn fits an elastic body
    /// ([`crate::unstable::ElasticModel`]) to the same touches.
    Elastic,
}

impl EstimatorKind {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Map, Self::Ekf, Self::Elastic];

    /// Its name in settings, files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Map => "map",
            Self::Ekf => "ekf",
            Self::Elastic => "elastic",
        }
    }

    /// The estimator of a name; `None` if there is none of it.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// What is known of one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct CellEstimate {
    /// K, N/m.
    pub stiffness_n_per_m: f64,
    /// Its standard deviation, N/m.
    pub std_n_per_m: f64,
    /// Frames that touched it.
    pub count: u32,
}

/// Bounds of every mean and standard deviation, N/m or N·m: none of this world lies outside, and
/// within them no product of them overflows.
const SMALLEST: f64 = 1e-9;
pub(crate) const LARGEST: f64 = 1e9;

/// Settings of either estimator.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[non_exhaustive]
pub struct EstimatorConfig {
    /// Stiffness of untouched cells.
    pub prior: Prior,
    /// σ_τ, N·m: one value for all joints, or one per joint. Stands for all that the model leaves
    /// unexplained, not for the sensor's noise alone.
    pub torque_std: Vec<f64>,
    /// Factor of K, learnt or prior, where it is shown or predicted with, 0 to 1; used by `map` alone. Below 1
    /// where the predictions of touches that were not learnt are too large.
    #[serde(default = "unscaled")]
    pub stiffness_scale: f64,
    /// Remembered frames visited again after each new one.
    pub replays: u32,
    /// Standard deviation of the drift ε of Eq. 4, N/m per step for a cell of 1 cm; used by `ekf` alone. 0
    /// by default: objects are taken not to change.
    pub drift_std_n_per_m: f64,
    /// Bound on the remembered frames.
    pub memory: MemoryLimits,
    /// Seed of the draws from memory.
    pub seed: u64,
}

/// The scale of fields that were saved without one.
fn unscaled() -> f64 {
    1.0
}

impl EstimatorConfig {
    /// The shipped settings of an estimator.
    pub fn of(method: EstimatorKind) -> Self {
        let memory = MemoryLimits { frames: 20_000, bytes: 256 << 20 };
        match method {
            EstimatorKind::Map | EstimatorKind::Elastic => Self {
                prior: Prior { mean_n_per_m: 0.0, std_n_per_m: 0.76 },
                torque_std: vec![0.2],
                stiffness_scale: 1.0,
                replays: 20,
                drift_std_n_per_m: 0.0,
                memory,
                seed: 0,
            },
            EstimatorKind::Ekf => Self {
                prior: Prior { mean_n_per_m: 0.006, std_n_per_m: 0.76 },
                // Replays count a measurement again and again; the noise is larger by as much.
                torque_std: vec![1.5],
                stiffness_scale: 1.0,
                replays: 20,
                drift_std_n_per_m: 0.0,
                memory,
                seed: 0,
            },
        }
    }

    /// Checks every setting against its range and returns R's diagonal, (N·m)², n_joints.
    ///
    /// # Errors
    ///
    /// Names the first setting out of range.
    pub fn torque_variance(&self, n_joints: usize) -> Result<DVector<f64>, EstimatorError> {
        let at_least_zero =
            [("prior mean", self.prior.mean_n_per_m), ("drift_std", self.drift_std_n_per_m)];
        for (setting, found) in at_least_zero {
            if !(0.0..=LARGEST).contains(&found) {
                let wanted = "from 0 to 1e9 N/m";
                return Err(SettingError::new(setting, found, wanted).into());
            }
        }
        let found = self.prior.std_n_per_m;
        if !(SMALLEST..=LARGEST).contains(&found) {
            let wanted = "from 1e-9 to 1e9 N/m";
            return Err(SettingError::new("prior std", found, wanted).into());
        }
        if !(0.0..=1.0).contains(&self.stiffness_scale) {
            return Err(
                SettingError::new("stiffness_scale", self.stiffness_scale, "from 0 to 1").into()
            );
        }
        if self.torque_std.len() != 1 && self.torque_std.len() != n_joints {
            let got = self.torque_std.len();
            return Err(EstimatorError::TorqueStdCount { got, expected: n_joints });
        }
        if let Some(&found) =
            self.torque_std.iter().find(|std| !(SMALLEST..=LARGEST).contains(*std))
        {
            let wanted = "from 1e-9 to 1e9 N·m";
            return Err(SettingError::new("torque_std", found, wanted).into());
        }
        let std = |joint: usize| self.torque_std[joint.min(self.torque_std.len() - 1)];
        Ok(DVector::from_fn(n_joints, |joint, _| std(joint).powi(2)))
    }
}

/// What was visited in a replay.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Replayed {
    /// Frames; none if none are remembered.
    pub frames: u32,
    /// Their contacts.
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
/// Rows that no frame has touched and that have no prior mean of their own have the prior.
pub trait Estimator: Send + Sync {
    /// K of a row, N/m, at least zero.
    fn stiffness(&self, row: usize) -> f64;

    /// Standard deviation of a row, N/m; see the estimators for what it means.
    fn std(&self, row: usize) -> f64;

    /// Frames that touched a row.
    fn count(&self, row: usize) -> u32;

    /// The estimate of the cell of a row; of a row that is none, such as `usize::MAX`, the prior.
    fn estimate(&self, row: usize) -> CellEstimate {
        CellEstimate {
            stiffness_n_per_m: self.stiffness(row),
            std_n_per_m: self.std(row),
            count: self.count(row),
        }
    }

    /// The estimates of the cells of the first rows, in one call: a query waits for them.
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

    /// Predicts a new frame, `τ̂ = H K` (Eq. 5), n_joints, N·m, and learns nothing; `points_m` as for
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

    /// s of [`Calibration::half_width`](crate::Calibration::half_width) of a frame before it is learnt from, n_joints, N·m;
    /// `points_m` as for [`Estimator::correct`].
    fn band_spread(
        &mut self,
        points_m: &[[f64; 3]],
        observation: &Observation,
        relative_std: f64,
    ) -> DVector<f64>;

    /// Lets a step without contact pass: with drift (Eq. 4), variances grow.
    fn advance_time(&mut self);

    /// Replays: fuses remembered frames again, drawn from memory.
    fn replay(&mut self, visits: u32) -> Replayed;

    /// Condenses the frames of a touch: they leave memory and are replayed no more, what was learnt from
    /// them stays in the belief.
    fn condense(&mut self, touch: u32);

    /// The remembered frames, in memory's order.
    fn frame_ids(&self) -> Vec<FrameId>;

    /// Of some remembered frames, about `most` of them evenly chosen: τ − τ̂ and τ, n_joints each, N·m, times the weight of
    /// each torque ([`Observation::weighted`]).
    fn errors(&self, most: usize) -> Vec<(FrameId, [DVector<f64>; 2])>;

    /// Bytes of the remembered frames.
    fn memory_bytes(&self) -> usize;

    /// The belief in numbers, for so many rows.
    fn state(&self, n_rows: usize) -> EstimatorState;

    /// Goes on from a saved state, given the rest points of all rows (world frame, m) and the remembered
    /// frames' observations in the state's order. Called on an estimator that has learnt nothing yet.
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
