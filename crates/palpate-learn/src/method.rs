//! The methods that are compared: the estimators, the paper's baselines, and the trivial `uniform` and `zero`.

use nalgebra::DVector;
use palpate::unstable::{CellState, Estimator, FrameId, StiffnessRule};
use palpate::{EstimatorKind, Field, MapperConfig};
use serde::{Deserialize, Serialize};

use crate::elastic;
use crate::error::{LearnError, Stop, unless_stopped};
use crate::folds::Fold;
use crate::regression::{Frames, Knn, RegressionError, Regressor};
#[cfg(feature = "regression")]
use crate::regression::{Gp, Mlp};
use crate::tracked::{TrackedFrame, TrackedTouches};

/// A method for predicting torques.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// An elastic body from a point cloud, and `map` for its residual ([`crate::elastic`]); `map` alone
    /// if the touches were tracked without a body ([`TrackedTouches::with_bodies`]).
    Elastic,
    /// The exact maximum a posteriori ([`palpate::EstimatorKind::Map`]).
    Map,
    /// The paper's filter ([`palpate::EstimatorKind::Ekf`]).
    Ekf,
    /// A multilayer perceptron, from joint angles alone.
    Mlp,
    /// A Gaussian process, from joint angles alone.
    Gp,
    /// The nearest neighbours, from joint angles alone.
    Knn,
    /// One stiffness for all cells, by least squares.
    Uniform,
    /// Predicts zero torque.
    Zero,
}

/// Predicted torques: touches × frames × n_joints, N·m.
pub type TorquesByTouch = Vec<Vec<Vec<f64>>>;

impl Method {
    /// All methods, in the order of tables.
    pub const ALL: [Self; 8] = [
        Self::Elastic,
        Self::Map,
        Self::Ekf,
        Self::Mlp,
        Self::Gp,
        Self::Knn,
        Self::Uniform,
        Self::Zero,
    ];

    /// The method of an estimator; of `elastic`, the one for its residual.
    pub(crate) fn of(estimator: EstimatorKind) -> Self {
        match estimator {
            EstimatorKind::Map | EstimatorKind::Elastic => Self::Map,
            EstimatorKind::Ekf => Self::Ekf,
        }
    }

    /// The name of the method in tables and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Elastic => "elastic",
            Self::Map => "map",
            Self::Ekf => "ekf",
            Self::Mlp => "mlp",
            Self::Gp => "gp",
            Self::Knn => "knn",
            Self::Uniform => "uniform",
            Self::Zero => "zero",
        }
    }

    /// Whether the method is in this build: `mlp` and `gp` need the feature `regression`.
    pub fn is_built(self) -> bool {
        cfg!(feature = "regression") || !matches!(self, Self::Mlp | Self::Gp)
    }

    /// Whether the method is one of palpate's estimators, not a baseline.
    pub(crate) fn is_estimator(self) -> bool {
        matches!(self, Self::Elastic | Self::Map | Self::Ekf)
    }

    /// Whether the method learns from joint angles alone, as the paper's baselines do.
    pub fn is_learnt_baseline(self) -> bool {
        matches!(self, Self::Mlp | Self::Gp | Self::Knn)
    }

    /// Learns a fold's training touches and predicts its test touches.
    ///
    /// `config` is used by the estimators only. `stop` is polled regularly.
    ///
    /// # Errors
    ///
    /// If a setting is out of its range, learning fails numerically, the method is not built, or `stop` returns true.
    pub fn predict(
        self,
        tracked: &TrackedTouches,
        fold: &Fold,
        config: &MapperConfig,
        stop: Stop<'_>,
    ) -> Result<TorquesByTouch, LearnError> {
        let of_field = |cells: &[CellState]| torques(tracked, fold, |frame| frame.predict(cells));
        match self {
            Self::Elastic if tracked.body.is_some() => {
                Ok(elastic::predict(tracked, fold, config, stop)?.torques)
            }
            Self::Elastic | Self::Map | Self::Ekf => {
                let estimator = learn(tracked, &fold.train, config, &[], stop)?;
                Ok(of_field(&tracked.with_stiffness(|row| estimator.stiffness(row))))
            }
            Self::Uniform => Ok(of_field(&uniform(tracked, &fold.train))),
            Self::Zero => Ok(torques(tracked, fold, |frame| vec![0.0; frame.target.len()])),
            #[cfg(feature = "regression")]
            Self::Mlp => regressed(Mlp::fit, tracked, fold, stop),
            #[cfg(feature = "regression")]
            Self::Gp => regressed(Gp::fit, tracked, fold, stop),
            #[cfg(not(feature = "regression"))]
            Self::Mlp | Self::Gp => Err(RegressionError::NotBuilt.into()),
            Self::Knn => regressed(Knn::fit, tracked, fold, stop),
        }
    }
}

/// Torques of a fold's test touches, predicted by a regression on joint positions.
fn regressed<R: Regressor>(
    fit: impl Fn(&Frames) -> Result<R, RegressionError>,
    tracked: &TrackedTouches,
    fold: &Fold,
    stop: Stop<'_>,
) -> Result<TorquesByTouch, LearnError> {
    unless_stopped(stop)?;
    let regressor = fit(&tracked.frames(&fold.train))?;
    let of = |&touch: &usize| {
        let tau = regressor.predict(&tracked.frames(&[touch]).q);
        tau.column_iter().map(|tau| tau.iter().copied().collect()).collect()
    };
    Ok(fold.test.iter().map(of).collect())
}

/// Learns touches frame by frame (correct, replay) as [`palpate::Mapper`] does, but with contacts
/// that were simulated before.
///
/// `prior_means_n_per_m` are the prior means of the first rows of [`TrackedTouches::cells`], N/m. Rows
/// after them have the common prior mean. See [`Estimator::set_prior_means`].
///
/// # Errors
///
/// If a setting is out of its range, or a frame cannot be used.
///
/// # Panics
///
/// If there are more means than rows, or one is negative or not finite.
pub fn learn(
    tracked: &TrackedTouches,
    touches: &[usize],
    config: &MapperConfig,
    prior_means_n_per_m: &[f64],
    stop: Stop<'_>,
) -> Result<Box<dyn Estimator>, LearnError> {
    let mut estimator = config.estimator(tracked.n_joints)?;
    estimator.set_prior_means(&tracked.points_m, prior_means_n_per_m);
    for (number, &touch) in touches.iter().enumerate() {
        for frame in &tracked.touches[touch].frames {
            unless_stopped(stop)?;
            if frame.observation.n_contacts() == 0 {
                estimator.advance_time();
                continue;
            }
            let source = FrameId { touch: number as u32, sample: frame.sample };
            let observation = frame.weighted(frame.observation.clone(), &config.estimator);
            estimator.correct(&tracked.points_m, observation, source)?;
            estimator.replay(config.estimator.replays);
        }
    }
    Ok(estimator)
}

/// The field of the cells that `estimator` has learnt.
pub fn field(tracked: &TrackedTouches, estimator: &dyn Estimator, config: &MapperConfig) -> Field {
    let rows = 0..tracked.cells.len();
    let seen: Vec<usize> = rows.filter(|&row| estimator.count(row) > 0).collect();
    let (contact, touch) = (config.contact.clone(), config.touch.clone());
    let untouched_n_per_m = estimator.stiffness(usize::MAX);
    let mut field = Field::new(tracked.lattice.clone(), contact, touch, untouched_n_per_m);
    field.cells = seen.iter().map(|&row| tracked.cells[row]).collect();
    field.stiffness_n_per_m = seen.iter().map(|&row| estimator.stiffness(row)).collect();
    field.std_n_per_m = seen.iter().map(|&row| estimator.std(row)).collect();
    field.counts = seen.iter().map(|&row| estimator.count(row)).collect();
    field
}

fn torques(
    tracked: &TrackedTouches,
    fold: &Fold,
    predict: impl Fn(&TrackedFrame) -> Vec<f64>,
) -> TorquesByTouch {
    let of = |&touch: &usize| tracked.touches[touch].frames.iter().map(&predict).collect();
    fold.test.iter().map(of).collect()
}

/// The constant stiffness that fits the touches best: `K = Σ h·τ / Σ h·h ≥ 0`, where h is the torque
/// of a field of 1 N/m.
fn uniform(tracked: &TrackedTouches, touches: &[usize]) -> Vec<CellState> {
    let unit = tracked.with_stiffness(|_| 1.0);
    let (mut explained, mut power) = (0.0, 0.0);
    for frame in touches.iter().flat_map(|&touch| &tracked.touches[touch].frames) {
        let h: DVector<f64> = frame.observation.predict(&unit, StiffnessRule::Positive);
        explained += h.dot(&frame.observation.tau());
        power += h.norm_squared();
    }
    let stiffness = if power > 0.0 { f64::max(explained / power, 0.0) } else { 0.0 };
    tracked.with_stiffness(|_| stiffness)
}
