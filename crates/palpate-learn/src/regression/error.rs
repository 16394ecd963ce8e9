//! Errors of the regressions.

/// Why a regression could not be fitted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum RegressionError {
    /// No frames.
    #[error("there is no frame to learn torques from: no touch leaves its contact-free start")]
    NoFrames,
    /// A method that is not in this build.
    #[error("networks and Gaussian processes need the feature `regression`")]
    NotBuilt,
    /// A value that is not finite.
    #[error("the {what} of joint {joint} in frame {frame} is {found}; wanted a finite number")]
    NotFinite { what: &'static str, joint: usize, frame: usize, found: f64 },
    /// A kernel matrix that cannot be factorised.
    #[error(
        "the kernel matrix of {frames} frames cannot be factorised at a noise variance of \
         {noise_variance:e}; it needs more noise"
    )]
    NotPositiveDefinite { frames: usize, noise_variance: f64 },
}
