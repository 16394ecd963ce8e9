//! The four figures of the paper's Table I.
//!
//! The error of a frame is ‖τ̂ − τ‖₂ over the joints, in N·m; the relative error is that over
//! ‖τ‖₂, taken only where ‖τ‖₂ ≥ 1 N·m, so that noise is not divided by almost zero.

use serde::{Deserialize, Serialize};

/// Frames with less torque than this have no relative error, N·m.
pub const RELATIVE_FROM_N_M: f64 = 1.0;

/// Mean and largest error, absolute and relative.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TorqueErrors {
    /// Mean error, N·m.
    pub avg_error: f64,
    /// Largest error, N·m.
    pub max_error: f64,
    /// Mean relative error; `None` if no frame reaches 1 N·m.
    pub avg_relative: Option<f64>,
    /// Largest relative error; `None` if no frame reaches 1 N·m.
    pub max_relative: Option<f64>,
}

impl TorqueErrors {
    /// From (mean, maximum) of the errors and of the relative errors.
    fn of(errors: Option<(f64, f64)>, relative: Option<(f64, f64)>) -> Option<Self> {
        let (avg_error, max_error) = errors?;
        let (avg_relative, max_relative) = relative.unzip();
        Some(Self { avg_error, max_error, avg_relative, max_relative })
    }
}

/// Running sums of the errors of frames, and of the errors of predicting zero on the same frames.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ErrorSum {
    /// ‖τ̂ − τ‖₂.
    error: Running,
    /// ‖τ‖₂, which is the error of predicting zero.
    size: Running,
    /// `error / size` of the frames with a size of at least [`RELATIVE_FROM_N_M`].
    relative: Running,
}

/// Count, sum and maximum of non-negative numbers.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Running {
    count: u64,
    sum: f64,
    max: f64,
}

impl Running {
    fn add(&mut self, number: f64) {
        self.merge(&Self { count: 1, sum: number, max: number });
    }

    fn merge(&mut self, other: &Self) {
        self.count += other.count;
        self.sum += other.sum;
        self.max = self.max.max(other.max);
    }

    /// Mean and maximum; `None` if nothing was added.
    fn figures(&self) -> Option<(f64, f64)> {
        (self.count > 0).then(|| (self.sum / self.count as f64, self.max))
    }
}

impl ErrorSum {
    /// Sums over frames, from predicted external torques and their targets, the measured or true ones, each n_joints, N·m.
    pub fn of<P: AsRef<[f64]>, T: AsRef<[f64]>>(
        predicted: impl IntoIterator<Item = P>,
        targets: impl IntoIterator<Item = T>,
    ) -> Self {
        let mut sum = Self::default();
        for (predicted, target) in predicted.into_iter().zip(targets) {
            sum.add(predicted.as_ref(), target.as_ref());
        }
        sum
    }

    /// Adds a frame: predicted external torque and its target, n_joints, N·m.
    pub fn add(&mut self, predicted: &[f64], target: &[f64]) {
        let error =
            predicted.iter().zip(target).map(|(p, t)| (p - t) * (p - t)).sum::<f64>().sqrt();
        let size = target.iter().map(|t| t * t).sum::<f64>().sqrt();
        self.error.add(error);
        self.size.add(size);
        if size >= RELATIVE_FROM_N_M {
            self.relative.add(error / size);
        }
    }

    /// Adds all frames of another sum.
    pub fn merge(&mut self, other: &Self) {
        self.error.merge(&other.error);
        self.size.merge(&other.size);
        self.relative.merge(&other.relative);
    }

    /// Number of frames added.
    pub fn frames(&self) -> u64 {
        self.error.count
    }

    /// Number of frames that have a relative error ([`RELATIVE_FROM_N_M`]).
    pub fn relative_frames(&self) -> u64 {
        self.relative.count
    }

    /// The four error figures; `None` without a frame.
    pub fn errors(&self) -> Option<TorqueErrors> {
        TorqueErrors::of(self.error.figures(), self.relative.figures())
    }

    /// The four error figures of predicting zero torque; `None` without a frame.
    pub fn zero(&self) -> Option<TorqueErrors> {
        TorqueErrors::of(self.size.figures(), self.relative.figures().map(|_| (1.0, 1.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_as_computed_by_hand() {
        let mut sum = ErrorSum::default();
        sum.add(&[3.0, 4.0], &[0.0, 0.0]); // error 5, too small for a ratio
        sum.add(&[0.0, 1.0], &[0.0, 2.0]); // error 1, relative 0.5
        sum.add(&[0.0, 0.0], &[3.0, 4.0]); // error 5, relative 1
        let errors = sum.errors().unwrap();
        assert!((errors.avg_error - 11.0 / 3.0).abs() < 1e-12);
        assert_eq!(errors.max_error, 5.0);
        assert_eq!((errors.avg_relative, errors.max_relative), (Some(0.75), Some(1.0)));
        let zero = sum.zero().unwrap();
        assert_eq!((zero.avg_error, zero.max_error), (7.0 / 3.0, 5.0));
        assert_eq!((zero.avg_relative, zero.max_relative), (Some(1.0), Some(1.0)));
    }

    #[test]
    fn predicting_zero_has_a_relative_error_of_one_and_sums_merge() {
        let (mut first, mut second, mut both) =
            (ErrorSum::default(), ErrorSum::default(), ErrorSum::default());
        for (sum, tau) in [(&mut first, [1.0, 2.0]), (&mut second, [-3.0, 0.1])] {
            sum.add(&[0.0, 0.0], &tau);
            both.add(&[0.0, 0.0], &tau);
        }
        first.merge(&second);
        assert_eq!(first, both);
        assert_eq!(both.errors().unwrap().avg_relative, Some(1.0));
        assert_eq!(both.errors(), both.zero());
        assert_eq!(ErrorSum::default().errors(), None);
    }
}
