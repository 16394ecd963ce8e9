//! Posterior of the regression.
//!
//! The unknowns, in this order:
//!
//! ```text
//! [ Δπ (10 · n_bodies) | payload (10) | delay |
//!   by joint: gain − 1, friction and drive, bias, slopes, offset and drift by touch ]
//! ```
//!
//! with the priors of [`super::prior`]. Gains multiply the torque of the masses, so the problem is not linear: each
//! step linearises it at the result of the last one.

use nalgebra::{DMatrix, DVector};
use palpate::unstable::N_INERTIAL_PARAMETERS;

use super::physical_consistency;
use super::prior::{Prior, Start, of_joint};
use super::rows::{BIAS, FRICTION, Rows, SLOPES, Sum};

/// Steps of the fixed-point iteration.
const STEPS: usize = 25;
/// Posterior of all unknowns, and the noise.
pub(super) struct Posterior {
    n_parameters: usize,
    n_joints: usize,
    of_joint: usize,
    start_parameters: DVector<f64>,
    payload_body: usize,
    /// Mean and covariance of all unknowns.
    pub(super) mean: DVector<f64>,
    pub(super) covariance: DMatrix<f64>,
    /// Standard deviation of a row's noise, by joint, in logged units.
    pub(super) noise: Vec<f64>,
    /// Largest torque of each joint, in logged units: the scale of the noise.
    efforts: Vec<f64>,
    /// Autocorrelation time of the residuals, in rows, by joint ([`Rows::correlated`]).
    correlated: Vec<f64>,
    /// Prior variance of all unknowns.
    pub(super) prior_variance: DVector<f64>,
    /// Whether each unknown is held near zero, since its estimate would be negative.
    pub(super) is_zero: Vec<bool>,
}

impl Posterior {
    /// `None` if the regression has no finite solution.
    pub(super) fn of(rows: &Rows, sums: &[Sum], start: &Start) -> Option<Self> {
        let mut correlated = vec![1.0; rows.n_joints()];
        for _ in 0..2 {
            correlated = rows.correlated(&Self::with(rows, sums, start, correlated)?);
        }
        Self::with(rows, sums, start, correlated)
    }

    /// The posterior if rows are taken as independent: takes a third of the time, but gives the URDF too little weight.
    pub(super) fn of_independent(rows: &Rows, sums: &[Sum], start: &Start) -> Option<Self> {
        Self::with(rows, sums, start, vec![1.0; rows.n_joints()])
    }

    fn with(rows: &Rows, sums: &[Sum], start: &Start, correlated: Vec<f64>) -> Option<Self> {
        let mut prior = Prior::new(rows, sums, start);
        let efforts: Vec<f64> = prior.efforts.clone();
        let mut posterior = Self {
            n_parameters: rows.n_parameters,
            n_joints: rows.n_joints(),
            of_joint: of_joint(rows),
            start_parameters: start.parameters.clone(),
            payload_body: start.payload_body,
            mean: prior.center.clone(),
            covariance: DMatrix::zeros(0, 0),
            noise: efforts.iter().map(|effort| 0.01 * effort).collect(),
            efforts,
            correlated,
            prior_variance: prior.variance(),
            is_zero: Vec::new(),
        };
        for step in 0..STEPS {
            if step == STEPS / 2 || step == 3 * STEPS / 4 {
                prior.hold_at_zero(&posterior);
            }
            posterior.prior_variance = prior.variance();
            posterior.solve(sums, &prior.center)?;
            prior.adapt(&posterior);
        }
        posterior.is_zero = prior.is_zero;
        posterior.make_possible(start)?;
        posterior.mean.iter().all(|value| value.is_finite()).then_some(posterior)
    }

    /// A Gauss-Newton step: the most probable coefficients, linearised at the last ones, and the noise.
    fn solve(&mut self, sums: &[Sum], center: &DVector<f64>) -> Option<()> {
        let mut precision = DMatrix::from_diagonal(&self.prior_variance.map(|v| 1.0 / v));
        let mut right = center.component_div(&self.prior_variance);
        let mut grams = Vec::with_capacity(self.n_joints);
        for (j, sum) in sums.iter().enumerate() {
            let design = self.design(j, sum.gram.ncols());
            let gram = &design * &sum.gram * design.transpose();
            let weight = 1.0 / (self.noise[j].powi(2) * self.correlated[j]);
            let own = self.own(j);
            for (a, row) in own.iter().enumerate() {
                for (b, column) in own.iter().enumerate() {
                    precision[(*row, *column)] += weight * gram[(a, b)];
                }
                right[*row] += weight * gram[(a, own.len())];
            }
            grams.push(gram);
        }
        self.covariance = inverse(&precision, self.shared(), self.of_joint)?;
        let mean = &self.covariance * &right;
        // One step of iterative refinement, against rounding errors.
        let left = right - precision * &mean;
        self.mean = mean + &self.covariance * left;

        // Noise variance: the mean squared residual, plus what the uncertainty of the coefficients adds to it.
        for (j, (gram, sum)) in grams.iter().zip(sums).enumerate() {
            if sum.rows == 0.0 {
                continue;
            }
            let own = self.own(j);
            let mut with_target = DVector::zeros(own.len() + 1);
            own.iter().enumerate().for_each(|(k, at)| with_target[k] = -self.mean[*at]);
            with_target[own.len()] = 1.0;
            let squares = with_target.dot(&(gram * &with_target)).max(0.0);
            let pairs = (0..own.len()).flat_map(|a| (0..own.len()).map(move |b| (a, b)));
            let uncertain: f64 =
                pairs.map(|(a, b)| gram[(a, b)] * self.covariance[(own[a], own[b])]).sum();
            let variance = (squares + uncertain) / sum.rows;
            self.noise[j] = variance.sqrt().max(1e-5 * self.efforts[j]).max(1e-9);
        }
        Some(())
    }

    /// Indices of the unknowns in a joint's rows: the shared ones and the joint's own.
    fn own(&self, j: usize) -> Vec<usize> {
        let shared = self.shared();
        let at = shared + j * self.of_joint;
        (0..shared).chain(at..at + self.of_joint).collect()
    }

    pub(super) fn shared(&self) -> usize {
        self.n_parameters + N_INERTIAL_PARAMETERS + 1
    }

    pub(super) fn payload_body(&self) -> usize {
        self.payload_body
    }

    /// Index of a joint's first unknown: its gain minus 1.
    pub(super) fn joint(&self, j: usize) -> usize {
        self.shared() + j * self.of_joint
    }

    /// The inertial parameters, payload included.
    pub(super) fn parameters(&self) -> DVector<f64> {
        let mut parameters = &self.start_parameters + self.mean.rows(0, self.n_parameters);
        let mut body =
            parameters.rows_mut(N_INERTIAL_PARAMETERS * self.payload_body, N_INERTIAL_PARAMETERS);
        body += self.mean.rows(self.n_parameters, N_INERTIAL_PARAMETERS);
        parameters
    }

    /// Remaining delay beyond that of the rows, and its standard deviation, s.
    pub(super) fn delay(&self) -> (f64, f64) {
        let at = self.shared() - 1;
        (self.mean[at], self.covariance[(at, at)].sqrt())
    }

    /// Gain of a joint.
    pub(super) fn gain(&self, j: usize) -> f64 {
        1.0 + self.mean[self.joint(j)]
    }

    /// The mean bias of a joint over the touches, as a linear combination of the unknowns: (index, factor).
    pub(super) fn mean_bias(&self, j: usize) -> Vec<(usize, f64)> {
        let at = self.joint(j) + 1;
        let touches = at + FRICTION + BIAS + SLOPES..at + self.of_joint - 1;
        let count = touches.len() as f64 / 2.0;
        let offsets = touches.step_by(2).map(|k| (k, -1.0 / count));
        std::iter::once((at + FRICTION, -1.0)).chain(offsets).collect()
    }

    /// The matrix that maps a row of [`Rows`] to a row of the linearised regression, with the target last.
    fn design(&self, j: usize, width: usize) -> DMatrix<f64> {
        let (parameters, gain) = (self.parameters(), self.gain(j));
        let own = self.shared() + self.of_joint;
        let mut design = DMatrix::zeros(own + 1, width);
        for k in 0..self.n_parameters {
            design[(k, k)] = gain;
            // y − g₀ Y π₀ + (g₀ − 1) Y π
            design[(own, k)] = -gain * self.start_parameters[k] + (gain - 1.0) * parameters[k];
            design[(self.shared(), k)] = parameters[k];
        }
        for k in 0..N_INERTIAL_PARAMETERS {
            design[(self.n_parameters + k, N_INERTIAL_PARAMETERS * self.payload_body + k)] = gain;
        }
        design[(self.shared() - 1, self.n_parameters)] = 1.0;
        for k in 1..self.of_joint {
            design[(self.shared() + k, self.n_parameters + k)] = 1.0;
        }
        design[(own, width - 1)] = 1.0;
        design
    }

    /// Coefficients whose product with a row of [`Rows`] is the residual.
    pub(super) fn row_coefficients(&self, j: usize) -> DVector<f64> {
        let at = self.joint(j);
        let mut coefficients = DVector::zeros(self.n_parameters + 1 + self.of_joint);
        let own = -self.gain(j) * self.parameters();
        coefficients.rows_mut(0, self.n_parameters).copy_from(&own);
        coefficients[self.n_parameters] = -self.delay().0;
        for k in 1..self.of_joint {
            coefficients[self.n_parameters + k] = -self.mean[at + k];
        }
        coefficients[self.n_parameters + self.of_joint] = 1.0;
        coefficients
    }

    /// Moves the masses to physically possible values, and all other unknowns to the most probable values given these.
    fn make_possible(&mut self, start: &Start) -> Option<()> {
        let count = self.n_parameters + N_INERTIAL_PARAMETERS;
        let covariance = self.covariance.view((0, 0), (count, count)).into_owned();
        let precision = covariance.cholesky()?.inverse();
        let mean = self.mean.rows(0, count).into_owned();
        let moved =
            physical_consistency::nearest(&mean, &precision, &start.parameters, &start.scales);
        let pull = &precision * (&moved - &mean);
        self.mean += self.covariance.columns(0, count) * pull;
        Some(())
    }

    /// Sum over the joints of the noise variance, relative to the squared largest torque.
    pub(super) fn residual_variance(&self) -> f64 {
        self.noise.iter().zip(&self.efforts).map(|(noise, effort)| (noise / effort).powi(2)).sum()
    }
}

/// Inverse of a block arrow matrix: a shared part (the masses), and blocks (joints) that are coupled to it but not to
/// each other. Uses the Schur complement of the blocks; `None` if the matrix is not positive definite.
fn inverse(matrix: &DMatrix<f64>, shared: usize, block: usize) -> Option<DMatrix<f64>> {
    let rest = matrix.nrows() - shared;
    let mut inverse = DMatrix::zeros(matrix.nrows(), matrix.nrows());
    let mut complement = matrix.view((0, 0), (shared, shared)).into_owned();
    let mut solved = DMatrix::zeros(rest, shared);
    for at in (0..rest).step_by(block) {
        let own = matrix.view((shared + at, shared + at), (block, block)).into_owned();
        let across = matrix.view((shared + at, 0), (block, shared));
        let own = own.cholesky()?.inverse();
        let part = &own * across;
        complement -= across.tr_mul(&part);
        solved.view_mut((at, 0), (block, shared)).copy_from(&part);
        inverse.view_mut((shared + at, shared + at), (block, block)).copy_from(&own);
    }
    let complement = complement.cholesky()?.inverse();
    let across = -(&solved * &complement);
    let mut others = inverse.view_mut((shared, shared), (rest, rest));
    others -= &across * solved.transpose();
    inverse.view_mut((0, 0), (shared, shared)).copy_from(&complement);
    inverse.view_mut((0, shared), (shared, rest)).copy_from(&across.transpose());
    inverse.view_mut((shared, 0), (rest, shared)).copy_from(&across);
    Some(inverse)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arrow_matrix_times_its_inverse_is_one() {
        let (shared, block, n) = (4, 3, 13);
        let of = |at: usize| at.checked_sub(shared).map(|at| at / block);
        let number = |a: usize, b: usize| ((a * b + a + b) as f64).sin();
        let matrix = DMatrix::from_fn(n, n, |a, b| match (of(a), of(b)) {
            (Some(own), Some(other)) if own != other => 0.0,
            _ => number(a, b) + if a == b { 8.0 } else { 0.0 },
        });
        let inverse = inverse(&matrix, shared, block).unwrap();
        assert!((matrix * inverse - DMatrix::identity(n, n)).amax() < 1e-12);
        let mut other = DMatrix::<f64>::identity(n, n);
        other[(0, 0)] = -1.0;
        assert!(super::inverse(&other, shared, block).is_none());
    }
}
