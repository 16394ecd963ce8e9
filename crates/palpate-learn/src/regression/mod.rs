//! External torques from joint angles alone: the paper's three baselines (Sec. III-A).
//!
//! `Mlp`, `Gp` (both with the feature `regression`) and [`Knn`] learn `q ↦ τ` from frames, without a robot model,
//! contacts, or order in time. They choose their hyperparameters (length scales, noise, when to stop) on the
//! training frames alone, so that a touch under test stays unseen.
//!
//! Positions are standardised to mean 0 and standard deviation 1 over the training frames, joint by joint; torques,
//! where it matters, by one standard deviation for all joints, since errors of all joints count alike. The caller
//! unwraps continuous joints. A fit runs on one thread and is reproducible bit by bit; folds can run in parallel.

mod draw;
mod error;
#[cfg_attr(not(feature = "regression"), allow(dead_code))] // partly used by `gp` and `mlp` only
mod frames;
#[cfg(feature = "regression")]
mod gp;
#[cfg(feature = "regression")]
mod kernel;
mod knn;
#[cfg(feature = "regression")]
mod mlp;
#[cfg(feature = "regression")]
mod network;
#[cfg_attr(not(feature = "regression"), allow(dead_code))] // partly used by `gp` and `mlp` only
mod scale;

pub(crate) use draw::shuffle;
pub use error::RegressionError;
pub use frames::{Frames, Regressor};
#[cfg(feature = "regression")]
pub use gp::Gp;
#[cfg(feature = "regression")]
pub use kernel::Kernel;
pub use knn::Knn;
#[cfg(feature = "regression")]
pub use mlp::Mlp;

#[cfg(test)]
#[cfg(feature = "regression")]
mod tests {
    use nalgebra::DMatrix;

    use super::frames::tests::surface;
    use super::*;

    #[test]
    fn fitting_twice_gives_the_same_bits_and_leaves_few_frames_usable() {
        let query = surface(7, 1).q;
        let two = |frames: &Frames| -> [DMatrix<f64>; 3] {
            [
                Knn::fit(frames).unwrap().predict(&query),
                // The kernel is chosen on fewer frames than there are, so that the random choice matters.
                Gp::fit_some(frames, frames.len(), 20).unwrap().predict(&query),
                Mlp::fit(frames).unwrap().predict(&query),
            ]
        };
        for (frames, touches) in [(100, 5), (100, 1), (3, 3), (1, 1)] {
            let frames = surface(frames, touches);
            let predicted = two(&frames);
            assert_eq!(predicted, two(&frames));
            assert!(predicted.iter().flatten().all(|tau| tau.is_finite()));
        }
    }
}
