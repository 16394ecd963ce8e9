//! Standardisation of positions and torques before a regression.

use nalgebra::DMatrix;

use super::frames::Frames;

/// Mean and standard deviation of every row (joint) of training frames.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Scale {
    mean: Vec<f64>,
    /// 0 for a row that is constant up to rounding.
    pub(super) deviation: Vec<f64>,
}

impl Scale {
    /// Mean and deviation of each row of a matrix with one column per frame.
    pub(super) fn of(frames: &DMatrix<f64>) -> Self {
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

    /// The scale of torques, one row per joint: one deviation for all joints, the root mean square of theirs.
    ///
    /// Errors of all joints count alike in N·m, and sensors are about equally noisy. A deviation of 1
    /// for every joint would amplify the noise of joints that measure almost no torque.
    pub(super) fn of_torques(tau: &DMatrix<f64>) -> Self {
        let Self { mean, deviation } = Self::of(tau);
        let squares: f64 = deviation.iter().map(|deviation| deviation * deviation).sum();
        let common = (squares / deviation.len() as f64).sqrt();
        Self { mean, deviation: vec![common; deviation.len()] }
    }

    /// Standardises to mean 0 and deviation 1; a row that was constant in training becomes 0.
    pub(super) fn standardised(&self, frames: &DMatrix<f64>) -> DMatrix<f64> {
        assert_eq!(frames.nrows(), self.mean.len(), "as many joints as were learnt from");
        DMatrix::from_fn(frames.nrows(), frames.ncols(), |row, frame| {
            let deviation = self.deviation[row];
            if deviation > 0.0 { (frames[(row, frame)] - self.mean[row]) / deviation } else { 0.0 }
        })
    }

    /// The inverse of [`Self::standardised`].
    pub(super) fn restored(&self, standardised: &DMatrix<f64>) -> DMatrix<f64> {
        DMatrix::from_fn(standardised.nrows(), standardised.ncols(), |row, frame| {
            self.mean[row] + self.deviation[row] * standardised[(row, frame)]
        })
    }
}

/// Scales of positions and torques, from training frames.
#[derive(Debug, Clone)]
pub(super) struct Scales {
    pub(super) positions: Scale,
    pub(super) torques: Scale,
}

impl Scales {
    pub(super) fn of(frames: &Frames) -> Self {
        Self { positions: Scale::of(&frames.q), torques: Scale::of_torques(&frames.tau) }
    }

    /// Standardised positions and torques of frames.
    pub(super) fn standardised(&self, frames: &Frames) -> [DMatrix<f64>; 2] {
        [self.positions.standardised(&frames.q), self.torques.standardised(&frames.tau)]
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::dmatrix;

    use super::*;

    #[test]
    fn standardised_rows_have_mean_0_and_deviation_1_and_come_back() {
        let frames = dmatrix![1.0, 2.0, 6.0; 7.0, 7.0, 7.0];
        let scale = Scale::of(&frames);
        let z = scale.standardised(&frames);
        assert!(z.row(0).sum().abs() < 1e-12 && (z.row(0).norm_squared() - 3.0).abs() < 1e-12);
        assert!((scale.restored(&z) - &frames).amax() < 1e-12);
        // A joint that stood still has no effect, even when it moves later.
        assert_eq!(scale.standardised(&dmatrix![1.0; 8.0])[(1, 0)], 0.0);
    }
}
