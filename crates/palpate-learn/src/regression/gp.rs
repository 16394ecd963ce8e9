//! An exact Gaussian process on at most 2,500 frames.
//!
//! The kernel's hyperparameters maximise the marginal likelihood of a random subset of frames; the
//! prediction is `k(q)ᵀ K⁻¹ Y` over all kept frames. Only the mean is computed: the evaluation does
//! not use the variance.

use nalgebra::DMatrix;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::draw::{shuffle, thinned};
use super::error::RegressionError;
use super::frames::{Frames, Regressor};
use super::kernel::{Kernel, likeliest};
use super::scale::Scales;

/// Most frames that are kept, evenly thinned; time grows with the cube, memory with the square.
const MAX_FRAMES: usize = 2_500;
/// Number of random frames whose likelihood chooses the kernel.
const LIKELIHOOD_FRAMES: usize = 400;
/// Steps of the search for the kernel.
const STEPS: usize = 80;
/// Seed of the random frames.
const SEED: u64 = 0;

/// A Gaussian process of torques over joint positions.
#[derive(Debug, Clone)]
pub struct Gp {
    scales: Scales,
    kernel: Kernel,
    /// Kept positions divided by the length scales, n_joints × frames.
    scaled: DMatrix<f64>,
    /// `K⁻¹Y`, n_joints × frames.
    weights: DMatrix<f64>,
    log_likelihood: f64,
}

impl Gp {
    /// Chooses the kernel of maximum likelihood, then fits the frames.
    ///
    /// Cost: O(frames³) up to 2,500 frames; more frames are thinned to 2,500.
    ///
    /// # Errors
    ///
    /// Without frames, with values that are not finite.
    pub fn fit(frames: &Frames) -> Result<Self, RegressionError> {
        Self::fit_some(frames, MAX_FRAMES, LIKELIHOOD_FRAMES)
    }

    /// Fits at most `max_frames` frames; the kernel is chosen on at most `likelihood_frames` of them.
    pub(super) fn fit_some(
        frames: &Frames,
        max_frames: usize,
        likelihood_frames: usize,
    ) -> Result<Self, RegressionError> {
        frames.check()?;
        let kept = frames.select(&thinned(frames.len(), max_frames));
        let mut drawn: Vec<usize> = (0..kept.len()).collect();
        shuffle(&mut drawn, &mut ChaCha8Rng::seed_from_u64(SEED));
        drawn.truncate(likelihood_frames);
        let [z, y] = Scales::of(&kept).standardised(&kept.select(&drawn));
        let kernel = likeliest(&z, &y, STEPS)?;
        Self::with_kernel(&kept, kernel)
    }

    /// Fits all frames with a given kernel.
    ///
    /// Cost: O(frames³).
    ///
    /// # Errors
    ///
    /// Without frames, with values that are not finite, or if the kernel matrix cannot be factorised:
    /// the kernel is not finite, or has too little noise.
    ///
    /// # Panics
    ///
    /// If the kernel does not have one length scale for every joint.
    pub fn with_kernel(frames: &Frames, kernel: Kernel) -> Result<Self, RegressionError> {
        frames.check()?;
        let scales = Scales::of(frames);
        let [z, y] = scales.standardised(frames);
        let scaled = kernel.scaled(&z);
        let solved = kernel.solve(&scaled, &y)?;
        let log_likelihood = solved.log_likelihood(&y);
        Ok(Self { scales, kernel, scaled, weights: solved.weights, log_likelihood })
    }

    /// Log marginal likelihood of the frames' standardised torques, summed over joints.
    pub fn log_likelihood(&self) -> f64 {
        self.log_likelihood
    }
}

impl Regressor for Gp {
    fn predict(&self, q: &DMatrix<f64>) -> DMatrix<f64> {
        let scaled = self.kernel.scaled(&self.scales.positions.standardised(q));
        let mut y = DMatrix::zeros(self.weights.nrows(), q.ncols());
        for (query, mut y) in scaled.column_iter().zip(y.column_iter_mut()) {
            for (position, weights) in self.scaled.column_iter().zip(self.weights.column_iter()) {
                let covariance = self.kernel.covariance(position.as_slice(), query.as_slice());
                y.axpy(covariance, &weights, 1.0);
            }
        }
        self.scales.torques.restored(&y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::regression::frames::tests::{surface, unexplained};

    fn kernel(noise_variance: f64) -> Kernel {
        Kernel { signal_variance: 1.0, noise_variance, length_scales: vec![0.5, 0.5] }
    }

    #[test]
    fn training_frames_are_reproduced_within_the_noise_and_exactly_without_it() {
        let frames = surface(60, 3);
        let deviation = Scales::of(&frames).torques.deviation[0];
        let miss = |noise_variance: f64| {
            let gp = Gp::with_kernel(&frames, kernel(noise_variance)).unwrap();
            (gp.predict(&frames.q) - &frames.tau).amax() / deviation
        };
        assert!(miss(1e-2) < 3.0 * 0.1 && miss(1e-2) > 1e-4, "{}", miss(1e-2));
        assert!(miss(1e-10) < 1e-6, "{}", miss(1e-10));
    }

    #[test]
    fn a_smooth_surface_is_learnt_from_thinned_frames() {
        let all = surface(400, 4);
        let (learnt, unseen) = (all.select(&thinned(300, 300)), all.select(&[301, 350, 377, 399]));
        let gp = Gp::fit_some(&learnt, 150, 80).unwrap();
        assert_eq!(gp.scaled.ncols(), 150);
        assert!(unexplained(&gp.predict(&unseen.q), &unseen.tau) < 1e-4);
    }

    #[test]
    fn copies_of_a_frame_without_noise_are_refused() {
        let frames = surface(5, 1).select(&[0, 0, 1, 1, 2, 2, 3, 3, 4, 4]);
        let error = Gp::with_kernel(&frames, kernel(1e-300)).unwrap_err();
        assert!(matches!(error, RegressionError::NotPositiveDefinite { frames: 10, .. }));
        assert!(Gp::with_kernel(&frames, kernel(f64::NAN)).is_err());
    }
}
