//! External torques from joint angles alone: the paper's three baselines (Sec. III-A).
//!
//! [`Mlp`], [`Gp`] and [`Knn`] learn `q ↦ τ` from frames, without a robot model, without contacts,
//! and without an order in time. Whatever they choose for themselves (length scales, noise, when to
//! stop) they choose from the frames that they are given, so that a touch under test stays unseen.
//!
//! Positions are standardised to mean 0 and deviation 1 of the training frames, each joint by its
//! own; torques, where it matters, by one deviation for all joints, as errors are counted. Angles are taken as they are: one that wraps is for the caller to unwrap. A fit runs
//! on one thread and gives the same bits every time; folds may run side by side.

mod gp;
mod kernel;
mod knn;
mod mlp;
mod network;

use std::ops::Range;

use nalgebra::DMatrix;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;

pub use gp::{Gp, GpConfig};
pub use kernel::Kernel;
pub use knn::{Knn, KnnConfig};
pub use mlp::{Mlp, MlpConfig};

/// Without whole touches to hold out, one frame in this many is: the last ones.
const HELD_OUT: usize = 5;

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

/// What has learnt to predict torques.
pub trait Regressor {
    /// Predicts external torques, n_joints × frames, N·m, at positions `q`, n_joints × frames, rad.
    ///
    /// # Panics
    ///
    /// If `q` has another number of joints than the frames that were learnt from.
    fn predict(&self, q: &DMatrix<f64>) -> DMatrix<f64>;
}

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

impl Frames {
    /// Number of frames.
    pub fn len(&self) -> usize {
        self.q.ncols()
    }

    /// Whether there is nothing to learn from.
    pub fn is_empty(&self) -> bool {
        self.q.is_empty() || self.tau.is_empty()
    }

    /// Refuses what cannot be learnt from.
    fn check(&self) -> Result<(), RegressionError> {
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
    fn select(&self, frames: &[usize]) -> Self {
        Self {
            q: self.q.select_columns(frames),
            tau: self.tau.select_columns(frames),
            touch: frames.iter().map(|&frame| self.touch[frame]).collect(),
        }
    }

    /// Parts that may be held out to see how well the rest predicts them: every touch, as the test
    /// will be a whole touch too; of a single touch its end; nothing of a handful of frames.
    fn parts(&self) -> Vec<Range<usize>> {
        let mut parts: Vec<Range<usize>> = Vec::new();
        for (frame, touch) in self.touch.iter().enumerate() {
            match parts.last_mut().filter(|part| self.touch[part.start] == *touch) {
                Some(part) => part.end = frame + 1,
                None => parts.push(frame..frame + 1),
            }
        }
        match parts.len() {
            0 | 1 => {
                let end = self.len() - self.len() / HELD_OUT..self.len();
                Some(end).filter(|end| !end.is_empty()).into_iter().collect()
            }
            _ => parts,
        }
    }
}

/// Mean and deviation of every row of some training frames.
#[derive(Debug, Clone, PartialEq)]
struct Scale {
    mean: Vec<f64>,
    /// 0 for a row that is constant but for rounding.
    deviation: Vec<f64>,
}

impl Scale {
    /// Of a matrix with a column a frame.
    fn of(frames: &DMatrix<f64>) -> Self {
        let n = frames.ncols() as f64;
        let mean: Vec<f64> = frames.row_iter().map(|row| row.sum() / n).collect();
        let deviation = |(row, mean): (usize, &f64)| {
            let squares: f64 = frames.row(row).iter().map(|value| (value - mean).powi(2)).sum();
            let deviation = (squares / n).sqrt();
            if deviation > 1e-12 * mean.abs() { deviation } else { 0.0 }
        };
        let deviation = mean.iter().enumerate().map(deviation).collect();
        Self { mean, deviation }
    }

    /// Of torques, a row a joint: one deviation for all, the root mean square of theirs.
    ///
    /// Errors are counted in N·m, whichever joint they are of, and sensors are about equally noisy.
    /// To give every joint a deviation of 1 would blow up the noise of those that feel nothing.
    fn of_torques(tau: &DMatrix<f64>) -> Self {
        let Self { mean, deviation } = Self::of(tau);
        let squares: f64 = deviation.iter().map(|deviation| deviation * deviation).sum();
        let common = (squares / deviation.len() as f64).sqrt();
        Self { mean, deviation: vec![common; deviation.len()] }
    }

    /// To mean 0 and deviation 1; a row that was constant becomes 0, whatever it is now.
    fn standardised(&self, frames: &DMatrix<f64>) -> DMatrix<f64> {
        assert_eq!(frames.nrows(), self.mean.len(), "as many joints as were learnt from");
        DMatrix::from_fn(frames.nrows(), frames.ncols(), |row, frame| {
            let deviation = self.deviation[row];
            if deviation > 0.0 { (frames[(row, frame)] - self.mean[row]) / deviation } else { 0.0 }
        })
    }

    /// Back to what was measured.
    fn restored(&self, standardised: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(standardised.nrows(), standardised.ncols(), |row, frame| {
            self.mean[row] + self.deviation[row] * standardised[(row, frame)]
        })
    }
}

/// `wanted` of `0..n`, evenly spread; all of them if there are no more.
fn thinned(n: usize, wanted: usize) -> Vec<usize> {
    let wanted = wanted.min(n);
    (0..wanted).map(|index| index * n / wanted).collect()
}

/// Puts items into random order (Fisher and Yates).
pub(crate) fn shuffle(items: &mut [usize], rng: &mut ChaCha8Rng) {
    for last in (1..items.len()).rev() {
        // Multiply and shift maps 32 random bits onto 0..=last; its bias is below n / 2³².
        let other = (u64::from(rng.next_u32()) * (last as u64 + 1)) >> 32;
        items.swap(last, other as usize);
    }
}

/// Refuses a setting that is not a finite number above zero.
fn positive(setting: &'static str, found: f64) -> Result<(), RegressionError> {
    let wanted = "a finite number above zero";
    let good = found.is_finite() && found > 0.0;
    good.then_some(()).ok_or(RegressionError::Setting { setting, found, wanted })
}

#[cfg(test)]
mod tests {
    use nalgebra::dmatrix;
    use rand_chacha::rand_core::SeedableRng;

    use super::*;

    /// A smooth map of two joints to two torques, in some touches; one draw, the same every time.
    pub(super) fn surface(frames: usize, touches: usize) -> Frames {
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
    pub(super) fn unexplained(predicted: &DMatrix<f64>, tau: &DMatrix<f64>) -> f64 {
        let mean = tau.column_mean();
        let spread: f64 = tau.column_iter().map(|tau| (tau - &mean).norm_squared()).sum();
        (predicted - tau).norm_squared() / spread
    }

    #[test]
    fn standardised_rows_have_mean_0_and_deviation_1_and_come_back() {
        let frames = dmatrix![1.0, 2.0, 6.0; 7.0, 7.0, 7.0];
        let scale = Scale::of(&frames);
        let z = scale.standardised(&frames);
        assert!(z.row(0).sum().abs() < 1e-12 && (z.row(0).norm_squared() - 3.0).abs() < 1e-12);
        assert!((scale.restored(&z) - &frames).amax() < 1e-12);
        // A joint that stood still tells nothing, even when it moves later.
        assert_eq!(scale.standardised(&dmatrix![1.0; 8.0])[(1, 0)], 0.0);
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

    #[test]
    fn fitting_twice_gives_the_same_bits_and_leaves_few_frames_usable() {
        let query = surface(7, 1).q;
        let two = |frames: &Frames| -> [DMatrix<f64>; 3] {
            let mlp = MlpConfig { epochs: 3, ..MlpConfig::default() };
            // Fewer than there are, so that the draw matters.
            let gp = GpConfig { likelihood_frames: 20, ..GpConfig::default() };
            [
                Knn::fit(frames, &KnnConfig::default()).unwrap().predict(&query),
                Gp::fit(frames, &gp).unwrap().predict(&query),
                Mlp::fit(frames, &mlp).unwrap().predict(&query),
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
