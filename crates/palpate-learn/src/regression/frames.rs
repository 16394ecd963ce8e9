//! Training frames of a regression, and the trait of a fitted one.

use std::ops::Range;

use nalgebra::DMatrix;

use super::error::RegressionError;

/// The inverse of the held-out share: one touch in five, or the last fifth of a single touch.
pub(super) const HELD_OUT: usize = 5;

/// Frames to learn from: joint positions in, external torques out.
#[derive(Debug, Clone, PartialEq)]
pub struct Frames {
    /// Joint positions, n_joints × frames, rad.
    pub q: DMatrix<f64>,
    /// External torques, n_joints × frames, N·m.
    pub tau: DMatrix<f64>,
    /// The touch of every frame, ascending.
    pub touch: Vec<usize>,
}

/// A fitted regression of torques.
pub trait Regressor {
    /// Predicts external torques, n_joints × frames, N·m, at positions `q`, n_joints × frames, rad.
    ///
    /// # Panics
    ///
    /// If `q` has another number of joints than the frames that were learnt from.
    fn predict(&self, q: &DMatrix<f64>) -> DMatrix<f64>;
}

impl Frames {
    /// Number of frames.
    pub fn len(&self) -> usize {
        self.q.ncols()
    }

    /// Whether there are no frames or no joints.
    pub fn is_empty(&self) -> bool {
        self.q.is_empty() || self.tau.is_empty()
    }

    /// Refuses frames that are empty or not finite.
    pub(super) fn check(&self) -> Result<(), RegressionError> {
        assert_eq!(self.q.ncols(), self.tau.ncols(), "torques for every frame");
        assert_eq!(self.q.ncols(), self.touch.len(), "a touch for every frame");
        assert!(self.touch.is_sorted(), "frames of a touch stand together");
        if self.is_empty() {
            return Err(RegressionError::NoFrames);
        }
        for (what, matrix) in [("position", &self.q), ("external torque", &self.tau)] {
            if let Some(index) = matrix.iter().position(|value| !value.is_finite()) {
                let (joint, frame) = (index % matrix.nrows(), index / matrix.nrows());
                let found = matrix[index];
                return Err(RegressionError::NotFinite { what, joint, frame, found });
            }
        }
        Ok(())
    }

    /// The frames with these indices, in this order.
    pub(super) fn select(&self, frames: &[usize]) -> Self {
        Self {
            q: self.q.select_columns(frames),
            tau: self.tau.select_columns(frames),
            touch: frames.iter().map(|&frame| self.touch[frame]).collect(),
        }
    }

    /// Parts that can be held out for validation: each touch, since a test touch is a whole touch too;
    /// the end of a single touch; none with fewer than [`HELD_OUT`] frames of a single touch.
    pub(super) fn parts(&self) -> Vec<Range<usize>> {
        let mut end = 0;
        let part = |touch: &[usize]| {
            let begin = end;
            end += touch.len();
            begin..end
        };
        let parts: Vec<Range<usize>> = self.touch.chunk_by(|a, b| a == b).map(part).collect();
        if parts.len() > 1 {
            return parts;
        }
        let end = self.len() - self.len() / HELD_OUT..self.len();
        if end.is_empty() { Vec::new() } else { vec![end] }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    use super::*;

    /// Frames of a smooth function of two joints to two torques, divided into touches; the same every time.
    pub(in crate::regression) fn surface(frames: usize, touches: usize) -> Frames {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut uniform = || 4.0 * f64::from(rng.next_u32()) / f64::from(u32::MAX) - 2.0;
        let q = DMatrix::from_fn(2, frames, |_, _| uniform());
        let tau = DMatrix::from_fn(2, frames, |row, frame| match row {
            0 => 3.0 * q[(0, frame)].sin() + q[(1, frame)],
            _ => (q[(0, frame)] * q[(1, frame)]).cos() - 5.0,
        });
        Frames { q, tau, touch: (0..frames).map(|frame| frame * touches / frames).collect() }
    }

    /// Squared errors over squared deviations from the mean.
    pub(in crate::regression) fn unexplained(predicted: &DMatrix<f64>, tau: &DMatrix<f64>) -> f64 {
        let mean = tau.column_mean();
        let spread: f64 = tau.column_iter().map(|tau| (tau - &mean).norm_squared()).sum();
        (predicted - tau).norm_squared() / spread
    }

    #[test]
    fn parts_are_touches_or_the_end_of_the_only_one() {
        assert_eq!(surface(10, 2).parts(), [0..5, 5..10]);
        assert_eq!(surface(10, 1).parts(), std::slice::from_ref(&(8..10)));
        assert!(surface(4, 1).parts().is_empty());
    }

    #[test]
    fn frames_that_cannot_be_learnt_from_are_refused_by_name() {
        let none = surface(0, 1);
        assert!(matches!(none.check(), Err(RegressionError::NoFrames)));
        let mut broken = surface(5, 1);
        broken.tau[(1, 3)] = f64::NAN;
        let error = broken.check().unwrap_err().to_string();
        assert_eq!(
            error,
            "the external torque of joint 1 in frame 3 is NaN; wanted a finite number"
        );
    }
}
