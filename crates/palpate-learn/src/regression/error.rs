//! Why a regression cannot learn.

/// Why nothing could be learnt from frames.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs)] // the messages name the fields
pub enum RegressionError {
    /// Nothing to learn from.
    #[error("there is no frame to learn torques from: no touch leaves its contact-free start")]
    NoFrames,
    /// A method that is not there.
    #[error("networks and Gaussian processes need the feature `regression`")]
    NotBuilt,
    /// A value that is no number.
    #[error("the {what} of joint {joint} in frame {frame} is {found}; wanted a finite number")]
    NotFinite { what: &'static str, joint: usize, frame: usize, found: f64 },
    /// A kernel that makes frames exact copies of each other.
    #[error(
        "the kernel matrix of {frames} frames cannot be factorised at a noise variance of \
         {noise_variance:e}; it needs more noise"
    )]
    NotPositiveDefinite { frames: usize, noise_variance: f64 },
}
