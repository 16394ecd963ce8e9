//! Errors of tracking and learning, and the check for cancellation.

use palpate::{EstimatorError, MapperError, SettingError};

use crate::regression::RegressionError;

/// Returns whether to stop; called regularly, from any thread.
pub type Stop<'a> = &'a (dyn Fn() -> bool + Sync);

/// What can go wrong in tracking touches and learning from them.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum LearnError {
    /// A sample that cannot be used.
    #[error("touch {touch}, sample {sample}: {source}")]
    Sample { touch: usize, sample: usize, source: MapperError },
    /// A sample of a logged touch, given by its number and name, that cannot be used.
    #[error("touch `{touch}`, sample {sample} (from 0): {source}")]
    Logged { touch: String, sample: usize, source: MapperError },
    /// True torques whose shape does not fit their touch.
    #[error("the truth of touch `{touch}` has {got}, the touch has {expected}")]
    Truth { touch: String, got: String, expected: String },
    /// Settings out of their range.
    #[error(transparent)]
    Settings(#[from] SettingError),
    #[error(transparent)]
    Estimator(#[from] EstimatorError),
    #[error(transparent)]
    Regression(#[from] RegressionError),
    /// Settings to be chosen for another estimator than `map`.
    #[error("settings are chosen for the estimator `map`, not for `{0}`")]
    NotMap(&'static str),
    /// No excitation can be found, or its start is not allowed.
    #[error("{0}")]
    Excite(String),
    /// No motion touches uncertain cells of the task.
    #[error(
        "no motion touches cells of the task with uncertain stiffness, so no motion can be ranked; check that task and \
         motions belong to this robot and field"
    )]
    NoTask,
    /// A field without calibrated bands.
    #[error(
        "no touches were held out when this field was learned, so it is unknown how well touches should fit; map its \
         logs again with at least three touches, without a prior, and with tuning unless the field has an elastic body"
    )]
    NoBands,
    /// Stopped by the caller.
    #[error("stopped")]
    Stopped,
}

/// Returns [`LearnError::Stopped`] if `stop` says so.
pub(crate) fn unless_stopped(stop: Stop<'_>) -> Result<(), LearnError> {
    if stop() { Err(LearnError::Stopped) } else { Ok(()) }
}
