//! External torques from joint angles alone: the paper's three baselines (Sec. III-A).
//!
//! `Mlp`, `Gp` (both with the feature `regression`) and [`Knn`] learn `q ↦ τ` from frames, without a robot model, without contacts,
//! and without an order in time. Whatever they choose for themselves (length scales, noise, when to
//! stop) they choose from the frames that they are given, so that a touch under test stays unseen.
//!
//! Positions are standardised to mean 0 and deviation 1 of the training frames, each joint by its
//! own; torques, where it matters, by one deviation for all joints, as errors are counted. Angles are
//! taken as they are: one that wraps is for the caller to unwrap. A fit runs on one thread and gives
//! the same bits every time; folds may run side by side.

mod draw;
mod error;
#[cfg_attr(not(feature = "regression"), allow(dead_code))] // what the others use
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
#[cfg_attr(not(feature = "regression"), allow(dead_code))] // what the others use
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
                // Fewer than there are choose the kernel, so that the draw matters.
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
