//! A low-rank approximation of a Gaussian process over features.
//!
//! The covariance `exp(−|x − x′|²/2ℓ²)` between two seen points is, to a thousandth, `φ(x)·φ(x′)`
//! with `φ(x) = L⁻¹ k(x)`, where k are the covariances with some *pivots* and `L Lᵀ` is the
//! covariance matrix of the pivots. The next pivot is always the point with the largest variance
//! given the pivots so far (pivoted Cholesky). So a stiffness over features is `φ(x)·w` with w of
//! unit covariance, and whatever is linear in stiffness is linear in w.

use nalgebra::{Cholesky, DMatrix, DVector, DVectorView, Dyn};

/// Most pivots, and most points that they are chosen from.
const PIVOTS: usize = 60;
const CANDIDATES: usize = 4000;
/// No further pivot is chosen if the variance of every point given the pivots is below this.
const UNEXPLAINED: f64 = 1e-3;
/// Added to the diagonal, so that the factorisation succeeds.
const JITTER: f64 = 1e-6;

/// The pivots, and the Cholesky factor L that gives φ.
pub(super) struct Basis {
    /// n_features × pivots.
    pivots: DMatrix<f64>,
    factor: Cholesky<f64, Dyn>,
    length_scale: f64,
}

impl Basis {
    /// Chooses pivots among points with these features, n_features × points.
    pub(super) fn new(features: &DMatrix<f64>, length_scale: f64) -> Self {
        let every = features.ncols().div_ceil(CANDIDATES).max(1);
        let candidates: Vec<usize> = (0..features.ncols()).step_by(every).collect();
        let candidates = features.select_columns(&candidates);
        let n = candidates.ncols();
        let mut unexplained = vec![1.0_f64; n];
        let mut columns: Vec<Vec<f64>> = Vec::new();
        let mut pivots = Vec::new();
        while pivots.len() < PIVOTS {
            let best = (0..n).max_by(|&a, &b| unexplained[a].total_cmp(&unexplained[b]));
            let Some(pivot) = best.filter(|&best| unexplained[best] > UNEXPLAINED) else { break };
            let scale = unexplained[pivot].sqrt();
            let column: Vec<f64> = (0..n)
                .map(|at| {
                    let known: f64 = columns.iter().map(|c| c[at] * c[pivot]).sum();
                    let [a, b] = [at, pivot].map(|point| candidates.column(point));
                    (covariance(&a, &b, length_scale) - known) / scale
                })
                .collect();
            unexplained.iter_mut().zip(&column).for_each(|(left, c)| *left -= c * c);
            columns.push(column);
            pivots.push(pivot);
        }
        let pivots = candidates.select_columns(&pivots);
        let among = DMatrix::from_fn(pivots.ncols(), pivots.ncols(), |a, b| {
            covariance(&pivots.column(a), &pivots.column(b), length_scale)
                + if a == b { JITTER } else { 0.0 }
        });
        let factor = among.cholesky().expect("a covariance with jitter is positive definite");
        Self { pivots, factor, length_scale }
    }

    /// Length of φ.
    pub(super) fn len(&self) -> usize {
        self.pivots.ncols()
    }

    /// Covariance of a point with a pivot, from 0 to 1.
    pub(super) fn covariance_with(&self, pivot: usize, features: &DVectorView<'_, f64>) -> f64 {
        covariance(&self.pivots.column(pivot), features, self.length_scale)
    }

    /// k of a point: its covariances with all pivots.
    pub(super) fn covariances(&self, features: &DVectorView<'_, f64>) -> DVector<f64> {
        DVector::from_fn(self.len(), |pivot, _| self.covariance_with(pivot, features))
    }

    /// `L⁻¹ m`: φ from k, column by column.
    pub(super) fn whitened(&self, mut m: DMatrix<f64>) -> DMatrix<f64> {
        let solved = self.factor.l_dirty().solve_lower_triangular_mut(&mut m);
        debug_assert!(solved, "a Cholesky factor has no zero on its diagonal");
        m
    }
}

fn covariance(a: &DVectorView<'_, f64>, b: &DVectorView<'_, f64>, length_scale: f64) -> f64 {
    let squares: f64 = a.iter().zip(b.iter()).map(|(a, b)| (a - b) * (a - b)).sum();
    (-0.5 * squares / (length_scale * length_scale)).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_phi_are_the_covariance() {
        let features = DMatrix::from_fn(2, 500, |row, at| ((at * (row + 3)) as f64 * 0.37).sin());
        let basis = Basis::new(&features, 1.0);
        assert!(basis.len() < PIVOTS, "{} pivots", basis.len());
        let phi = |at: usize| {
            let k = basis.covariances(&features.column(at));
            basis.whitened(DMatrix::from_column_slice(k.len(), 1, k.as_slice()))
        };
        for (a, b) in [(0, 0), (3, 250), (17, 499), (100, 101)] {
            let wanted = covariance(&features.column(a), &features.column(b), 1.0);
            assert!((phi(a).dot(&phi(b)) - wanted).abs() < 3e-3, "{a} {b}");
        }
    }

    #[test]
    fn features_that_are_all_zero_leave_one_pivot() {
        assert_eq!(Basis::new(&DMatrix::zeros(2, 100), 1.0).len(), 1);
    }
}
