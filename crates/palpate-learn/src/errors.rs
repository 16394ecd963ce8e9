//! The four figures of the paper's Table I.
//!
//! The error of a frame is ‖τ̂ − τ‖₂ over the joints, in N·m; the relative error is that over
//! ‖τ‖₂, taken only where ‖τ‖₂ ≥ 1 N·m so that noise is not divided by nothing.

use nalgebra::DVector;
use serde::{Deserialize, Serialize};

/// Frames with less torque than this have no relative error, N·m.
pub const RELATIVE_FROM: f64 = 1.0;

/// Mean and largest error, absolute and relative.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Mean error, N·m.
    pub avg_error: f64,
    /// Largest error, N·m.
    pub max_error: f64,
    /// Mean relative error; `None` if no frame reaches 1 N·m.
    pub avg_relative: Option<f64>,
    /// Largest relative error; `None` if no frame reaches 1 N·m.
    pub max_relative: Option<f64>,
}

/// Errors of frames, added up one by one.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ErrorSum {
    frames: u64,
    sum: f64,
    max: f64,
    relative_frames: u64,
    relative_sum: f64,
    relative_max: f64,
}

impl ErrorSum {
    /// Of predicted and true external torques, frame by frame, each n_joints, N·m.
    pub fn of<P: AsRef<[f64]>, T: AsRef<[f64]>>(
        predicted: impl IntoIterator<Item = P>,
        truth: impl IntoIterator<Item = T>,
    ) -> Self {
        let mut sum = Self::default();
        for (predicted, truth) in predicted.into_iter().zip(truth) {
            sum.add_slices(predicted.as_ref(), truth.as_ref());
        }
        sum
    }

    /// Of predicting zero.
    pub fn of_zero(truth: &[Vec<f64>]) -> Self {
        Self::of(truth.iter().map(|truth| vec![0.0; truth.len()]), truth)
    }

    /// Adds a frame: predicted and true external torque, n_joints, N·m.
    pub fn add(&mut self, predicted: &DVector<f64>, truth: &DVector<f64>) {
        self.add_slices(predicted.as_slice(), truth.as_slice());
    }

    /// [`ErrorSum::add`] of two frames as slices.
    pub fn add_slices(&mut self, predicted: &[f64], truth: &[f64]) {
        let norm = |squares: f64| squares.sqrt();
        let error = norm(predicted.iter().zip(truth).map(|(p, t)| (p - t) * (p - t)).sum::<f64>());
        self.frames += 1;
        self.sum += error;
        self.max = self.max.max(error);
        let size = norm(truth.iter().map(|t| t * t).sum::<f64>());
        if size >= RELATIVE_FROM {
            self.relative_frames += 1;
            self.relative_sum += error / size;
            self.relative_max = self.relative_max.max(error / size);
        }
    }

    /// Adds all frames of another sum.
    pub fn merge(&mut self, other: &Self) {
        self.frames += other.frames;
        self.sum += other.sum;
        self.max = self.max.max(other.max);
        self.relative_frames += other.relative_frames;
        self.relative_sum += other.relative_sum;
        self.relative_max = self.relative_max.max(other.relative_max);
    }

    /// Frames added.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Frames that count for the relative errors.
    pub fn relative_frames(&self) -> u64 {
        self.relative_frames
    }

    /// The four figures; `None` without a frame.
    pub fn errors(&self) -> Option<Errors> {
        let relative = |value: f64| (self.relative_frames > 0).then_some(value);
        (self.frames > 0).then(|| Errors {
            avg_error: self.sum / self.frames as f64,
            max_error: self.max,
            avg_relative: relative(self.relative_sum / self.relative_frames as f64),
            max_relative: relative(self.relative_max),
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::dvector;

    use super::*;

    #[test]
    fn figures_of_a_case_on_paper() {
        let mut sum = ErrorSum::default();
        sum.add(&dvector![3.0, 4.0], &dvector![0.0, 0.0]); // error 5, too small for a ratio
        sum.add(&dvector![0.0, 1.0], &dvector![0.0, 2.0]); // error 1, relative 0.5
        sum.add(&dvector![0.0, 0.0], &dvector![3.0, 4.0]); // error 5, relative 1
        let errors = sum.errors().unwrap();
        assert!((errors.avg_error - 11.0 / 3.0).abs() < 1e-12);
        assert_eq!(errors.max_error, 5.0);
        assert_eq!((errors.avg_relative, errors.max_relative), (Some(0.75), Some(1.0)));
    }

    #[test]
    fn predicting_zero_has_a_relative_error_of_one_and_sums_merge() {
        let zero = dvector![0.0, 0.0];
        let (mut first, mut second, mut both) =
            (ErrorSum::default(), ErrorSum::default(), ErrorSum::default());
        for (sum, tau) in [(&mut first, dvector![1.0, 2.0]), (&mut second, dvector![-3.0, 0.1])] {
            sum.add(&zero, &tau);
            both.add(&zero, &tau);
        }
        first.merge(&second);
        assert_eq!(first, both);
        assert_eq!(both.errors().unwrap().avg_relative, Some(1.0));
        assert_eq!(ErrorSum::default().errors(), None);
    }
}
