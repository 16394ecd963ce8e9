//! Why a regression cannot learn.

/// Why nothing could be learnt from frames.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum RegressionError {
    /// Nothing to learn from.
    #[error("there is no frame to learn torques from: no touch leaves its contact-free start")]
    NoFrames,
    /// A value that is no number.
    #[error("the {what} of joint {joint} in frame {frame} is {found}; wanted a finite number")]
    NotFinite { what: &'static str, joint: usize, frame: usize, found: f64 },
    /// A kernel that makes frames exact copies of each other.
    #[error(
        "the kernel matrix of {frames} frames cannot be factorised at a noise variance of \
         {noise_variance:e}; it needs more noise"
    )]
    NotPositiveDefinite { frames: usize, noise_variance: f64 },
    /// A setting out of its range.
    #[error("`{setting}` is {found}; wanted {wanted}")]
    Setting { setting: &'static str, found: f64, wanted: &'static str },
}

/// Refuses a setting that is not a finite number above zero.
pub(super) fn positive(setting: &'static str, found: f64) -> Result<(), RegressionError> {
    let wanted = "a finite number above zero";
    let good = found.is_finite() && found > 0.0;
    good.then_some(()).ok_or(RegressionError::Setting { setting, found, wanted })
}
