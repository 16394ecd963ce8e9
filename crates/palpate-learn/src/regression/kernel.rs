//! The covariance of a Gaussian process, and its marginal likelihood.
//!
//! The covariance of standardised positions a and b is `s² exp(−½ Σ_d (a_d − b_d)²/ℓ_d²)`, plus `σ²`
//! if they are the same frame. The torques of all joints share it: one factorisation serves all,
//! and the likelihoods of the joints are multiplied.
//!
//! With `A = K⁻¹Y` for m joints the gradient of the log marginal likelihood is
//! `½ tr((AAᵀ − m K⁻¹) ∂K)` (Rasmussen and Williams, Eq. 5.9, summed over joints).

use faer::linalg::solvers::{DenseSolveCore, Llt, Solve};
use faer::{Mat, Side};
use nalgebra::DMatrix;

use super::error::RegressionError;

/// Bound of the absolute logarithms of hyperparameters: a factor of 3,000 in both directions.
const LOG_RANGE: f64 = 8.0;

/// Noise variance at the start of the search; all other hyperparameters start at 1.
const BEGIN_NOISE: f64 = 0.01;

/// Logarithm of the smallest noise variance: with less, matrices might not be factorisable.
const LOG_NOISE_FROM: f64 = -14.0;

/// Squared-exponential covariance with noise, of standardised positions and torques.
#[derive(Debug, Clone, PartialEq)]
pub struct Kernel {
    /// Variance s² that depends on the position, of standardised torques.
    pub signal_variance: f64,
    /// Variance σ² of the noise, of standardised torques.
    pub noise_variance: f64,
    /// Length scales ℓ, n_joints, in standard deviations of the joint's position.
    pub length_scales: Vec<f64>,
}

/// A factorised kernel matrix K, and the weights of the frames.
pub(super) struct Solved {
    factor: Llt<f64>,
    /// `Aᵀ = (K⁻¹Y)ᵀ`, n_joints × frames.
    pub(super) weights: DMatrix<f64>,
}

impl Kernel {
    /// Positions divided by the length scales, n_joints × frames.
    pub(super) fn scaled(&self, z: &DMatrix<f64>) -> DMatrix<f64> {
        assert_eq!(self.length_scales.len(), z.nrows(), "a length scale for every joint");
        DMatrix::from_fn(z.nrows(), z.ncols(), |row, frame| {
            z[(row, frame)] / self.length_scales[row]
        })
    }

    /// Covariance without noise of two scaled positions.
    pub(super) fn covariance(&self, a: &[f64], b: &[f64]) -> f64 {
        let squares: f64 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
        self.signal_variance * (-0.5 * squares).exp()
    }

    /// Solves for torques `y`, n_joints × frames, at scaled positions.
    pub(super) fn solve(
        &self,
        scaled: &DMatrix<f64>,
        y: &DMatrix<f64>,
    ) -> Result<Solved, RegressionError> {
        let frames = scaled.ncols();
        let position =
            |frame: usize| &scaled.as_slice()[frame * scaled.nrows()..][..scaled.nrows()];
        let lower = Mat::from_fn(frames, frames, |row, column| match row.checked_sub(column) {
            None => 0.0, // the upper triangle is not used
            Some(0) => self.covariance(position(row), position(row)) + self.noise_variance,
            Some(_) => self.covariance(position(column), position(row)),
        });
        let factor = Llt::new(lower.as_ref(), Side::Lower).map_err(|_| {
            let noise_variance = self.noise_variance;
            RegressionError::NotPositiveDefinite { frames, noise_variance }
        })?;
        let mut weights = Mat::from_fn(frames, y.nrows(), |frame, joint| y[(joint, frame)]);
        factor.solve_in_place(&mut weights);
        let weights = DMatrix::from_fn(y.nrows(), frames, |joint, frame| weights[(frame, joint)]);
        Ok(Solved { factor, weights })
    }

    /// From the logarithms of signal variance, noise variance and length scales.
    fn from_logs(logs: &[f64]) -> Self {
        Self {
            signal_variance: logs[0].exp(),
            noise_variance: logs[1].exp(),
            length_scales: logs[2..].iter().map(|log| log.exp()).collect(),
        }
    }
}

impl Solved {
    /// Log marginal likelihood of torques `y`, n_joints × frames, summed over joints.
    pub(super) fn log_likelihood(&self, y: &DMatrix<f64>) -> f64 {
        let frames = y.ncols();
        let half_log_determinant: f64 = (0..frames).map(|i| self.factor.L()[(i, i)].ln()).sum();
        let mut fit = 0.0;
        for (joint, row) in y.row_iter().enumerate() {
            fit += row.iter().zip(&self.weights.row(joint)).map(|(y, a)| y * a).sum::<f64>();
        }
        let constant = half_log_determinant + 0.5 * frames as f64 * std::f64::consts::TAU.ln();
        -0.5 * fit - y.nrows() as f64 * constant
    }
}

/// Log marginal likelihood of standardised torques `y` at standardised positions `z`, both
/// n_joints × frames, and its gradient by the logarithms of signal variance, noise variance and
/// length scales.
fn likelihood(
    kernel: &Kernel,
    z: &DMatrix<f64>,
    y: &DMatrix<f64>,
) -> Result<(f64, Vec<f64>), RegressionError> {
    let scaled = kernel.scaled(z);
    let solved = kernel.solve(&scaled, y)?;
    let inverse = solved.factor.inverse();
    let log_likelihood = solved.log_likelihood(y);
    let weights = &solved.weights;
    let (n_joints, frames) = (y.nrows() as f64, y.ncols());
    let mut gradient = vec![0.0; 2 + z.nrows()];
    let mut squares = vec![0.0; z.nrows()];
    for column in 0..frames {
        for row in column..frames {
            let product = weights.column(row).dot(&weights.column(column));
            let slope = product - n_joints * inverse[(row, column)];
            for (joint, square) in squares.iter_mut().enumerate() {
                *square = (scaled[(joint, row)] - scaled[(joint, column)]).powi(2);
            }
            let covariance = (-0.5 * squares.iter().sum::<f64>()).exp() * kernel.signal_variance;
            // Off-diagonal entries count twice, which cancels the ½ of the trace.
            let half = if row == column { 0.5 } else { 1.0 };
            gradient[0] += half * slope * covariance;
            for (gradient, square) in gradient[2..].iter_mut().zip(&squares) {
                *gradient += half * slope * covariance * square;
            }
            if row == column {
                gradient[1] += half * slope * kernel.noise_variance;
            }
        }
    }
    Ok((log_likelihood, gradient))
}

/// The kernel of maximum likelihood, with logarithms of hyperparameters in range.
///
/// Ascends by the signs of the gradient alone (Rprop): every hyperparameter has its own step, which
/// grows while its derivative keeps the sign and shrinks when the sign changes. A kernel that cannot be
/// factorised ends the search.
///
/// Cost: O(`steps` · frames³), 10 ms per step for 400 frames.
pub(super) fn likeliest(
    z: &DMatrix<f64>,
    y: &DMatrix<f64>,
    steps: usize,
) -> Result<Kernel, RegressionError> {
    let mut logs = vec![0.0; 2 + z.nrows()];
    logs[1] = BEGIN_NOISE.ln();
    let (mut best, mut best_logs) = (f64::NEG_INFINITY, logs.clone());
    let mut strides = vec![0.5; logs.len()];
    let mut before = vec![0.0; logs.len()];
    for step in 0..=steps {
        let (value, gradient) = match likelihood(&Kernel::from_logs(&logs), z, y) {
            Ok(found) => found,
            Err(error) if step == 0 => return Err(error),
            Err(_) => break,
        };
        if value > best {
            best = value;
            best_logs.copy_from_slice(&logs);
        }
        for (index, slope) in gradient.iter().enumerate() {
            let turned = slope * before[index] < 0.0;
            let factor = if turned { 0.5 } else { 1.2 };
            strides[index] = f64::clamp(strides[index] * factor, 1e-6, 1.0);
            // After a change of sign there is no step this time; the next one goes in the new direction.
            before[index] = if turned { 0.0 } else { *slope };
            let from = if index == 1 { LOG_NOISE_FROM } else { -LOG_RANGE };
            let moved = logs[index] + strides[index] * sign(before[index]);
            logs[index] = moved.clamp(from, LOG_RANGE);
        }
    }
    Ok(Kernel::from_logs(&best_logs))
}

/// −1, 0 or 1.
fn sign(value: f64) -> f64 {
    if value == 0.0 { 0.0 } else { value.signum() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::regression::frames::tests::surface;
    use crate::regression::scale::Scale;

    fn data() -> (DMatrix<f64>, DMatrix<f64>) {
        let frames = surface(30, 1);
        let y = Scale::of_torques(&frames.tau).standardised(&frames.tau);
        (Scale::of(&frames.q).standardised(&frames.q), y)
    }

    #[test]
    fn the_gradient_is_the_slope_of_the_likelihood() {
        let (z, y) = data();
        let logs = [1.3_f64, 0.05, 0.7, 1.9].map(f64::ln);
        let (_, gradient) = likelihood(&Kernel::from_logs(&logs), &z, &y).unwrap();
        for (index, slope) in gradient.iter().enumerate() {
            let step = 1e-5;
            let at = |nudge: f64| {
                let mut logs = logs;
                logs[index] += nudge;
                likelihood(&Kernel::from_logs(&logs), &z, &y).unwrap().0
            };
            let wanted = (at(step) - at(-step)) / (2.0 * step);
            assert!(
                (slope - wanted).abs() < 1e-5 * wanted.abs().max(1.0),
                "{index}: {slope} {wanted}"
            );
        }
    }

    #[test]
    fn the_likeliest_kernel_is_flat_in_every_direction() {
        let (z, y) = data();
        // The surface has no noise, so the noise variance alone is at its limit.
        let kernel = likeliest(&z, &y, 200).unwrap();
        let begin = Kernel::from_logs(&[0.0, BEGIN_NOISE.ln(), 0.0, 0.0]);
        let (value, gradient) = likelihood(&kernel, &z, &y).unwrap();
        assert!(value > likelihood(&begin, &z, &y).unwrap().0);
        for index in [0, 2, 3] {
            assert!(gradient[index].abs() < 0.1, "{kernel:?} {gradient:?}");
        }
    }
}
