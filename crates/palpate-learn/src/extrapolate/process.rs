//! Stiffness as a Gaussian process over features, learnt from readings that are linear in it.
//!
//! `K(x) = φ(x)·w + 3c`, w and c of variance a² each, and readings `y = A·(w, c, …) + noise`. The
//! posterior is that of linear regression; the readings are those of [`super::torque_evidence`] or [`super::cells`].
//! Its covariance is scaled by the residual of the readings, so that twice the torques give twice the
//! stiffness and twice the standard deviation.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::basis::Basis;

/// Prior standard deviation of the common stiffness of all points, relative to that of differences
/// between points. So the common stiffness, and not zero, is expected of an untouched colour.
const IN_COMMON: f64 = 3.0;

/// Points that are processed together.
const BLOCK: usize = 4096;

/// Features of all seen points, and the basis functions over them.
pub(super) struct Process {
    features: DMatrix<f64>,
    basis: Basis,
}

/// Evidence of readings: the sums of the normal equations.
#[derive(Debug, Clone)]
pub(super) struct Evidence {
    /// Weighted sum `Σ a aᵀ` over rows a of A.
    pub(super) gram: DMatrix<f64>,
    /// Weighted sum `Σ a y`.
    pub(super) moment: DVector<f64>,
    /// Weighted sum `Σ y²`.
    pub(super) power: f64,
    /// Sum of the weights: effective number of readings.
    pub(super) readings: f64,
}

/// Posterior of (w, c, …) given the readings.
#[derive(Debug, Clone)]
pub(super) struct Posterior {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Process {
    /// A process over features, n_features × points, with a length scale in the units of the features.
    pub(super) fn new(features: DMatrix<f64>, length_scale: f64) -> Self {
        let basis = Basis::new(&features, length_scale);
        Self { features, basis }
    }

    /// Length of w, plus one for c.
    pub(super) fn len(&self) -> usize {
        self.basis.len() + 1
    }

    /// One of the functions before whitening, at these points: the covariance with a pivot; the last
    /// one is the constant of the common stiffness. None is negative.
    pub(super) fn covariance_with(&self, function: usize, points: &[u32]) -> Vec<f64> {
        if function == self.basis.len() {
            return vec![IN_COMMON; points.len()];
        }
        let of = |&point: &u32| self.basis.covariance_with(function, &self.column(point as usize));
        points.iter().map(of).collect()
    }

    /// `(φ(x), 3)` of these points, one column each.
    pub(super) fn phi(&self, points: impl ExactSizeIterator<Item = usize>) -> DMatrix<f64> {
        let mut k = DMatrix::zeros(self.basis.len(), points.len());
        for (point, mut column) in points.zip(k.column_iter_mut()) {
            column.copy_from(&self.basis.covariances(&self.column(point)));
        }
        let n = k.nrows();
        self.basis.whitened(k).insert_row(n, IN_COMMON)
    }

    /// Transforms evidence over covariances with pivots to evidence over φ; other unknowns are not changed.
    pub(super) fn whitened(&self, evidence: Evidence) -> Evidence {
        let rows = self.basis.len();
        let whiten = |mut m: DMatrix<f64>| {
            let above = self.basis.whitened(m.rows(0, rows).into_owned());
            m.rows_mut(0, rows).copy_from(&above);
            m
        };
        let gram = whiten(whiten(evidence.gram).transpose());
        let moment = whiten(DMatrix::from_column_slice(
            evidence.moment.len(),
            1,
            evidence.moment.as_slice(),
        ));
        Evidence { gram, moment: moment.column(0).into_owned(), ..evidence }
    }

    /// Mean and standard deviation of K at every point, N/m, the mean at least 0.
    pub(super) fn at_all_points(&self, posterior: &Posterior) -> (Vec<f64>, Vec<f64>) {
        let n = self.features.ncols();
        let blocks: Vec<(Vec<f64>, Vec<f64>)> = (0..n.div_ceil(BLOCK))
            .into_par_iter()
            .map(|block| {
                let phi = self.phi(block * BLOCK..n.min((block + 1) * BLOCK));
                let known = self.len();
                let mean = phi.tr_mul(&posterior.mean.rows(0, known));
                let spread = posterior.covariance.view((0, 0), (known, known)) * &phi;
                let deviation = (phi.column_iter().zip(spread.column_iter()))
                    .map(|(phi, spread)| phi.dot(&spread).max(0.0).sqrt());
                (mean.iter().map(|mean| mean.max(0.0)).collect(), deviation.collect())
            })
            .collect();
        let (means, deviations): (Vec<_>, Vec<_>) = blocks.into_iter().unzip();
        (means.concat(), deviations.concat())
    }

    fn column(&self, point: usize) -> nalgebra::DVectorView<'_, f64> {
        self.features.column(point)
    }
}

impl Evidence {
    /// No evidence, for this number of unknowns.
    pub(super) fn none(unknowns: usize) -> Self {
        Self {
            gram: DMatrix::zeros(unknowns, unknowns),
            moment: DVector::zeros(unknowns),
            power: 0.0,
            readings: 0.0,
        }
    }

    /// Adds the evidence of other readings.
    pub(super) fn add(&mut self, other: &Self) {
        self.gram += &other.gram;
        self.moment += &other.moment;
        self.power += other.power;
        self.readings += other.readings;
    }
}

impl Posterior {
    /// The posterior for this standard deviation of the prior and of the noise.
    pub(super) fn new(evidence: &Evidence, prior_std: f64, noise_std: f64) -> Self {
        let noise_variance = noise_std * noise_std;
        let mut precision = &evidence.gram / noise_variance;
        for unknown in 0..precision.nrows() {
            precision[(unknown, unknown)] += prior_std.powi(-2);
        }
        let covariance = match precision.clone().cholesky() {
            Some(factor) => factor.inverse(),
            None => precision.pseudo_inverse(1e-12).expect("a tolerance above 0"),
        };
        let mean = &covariance * &evidence.moment / noise_variance;
        // The most likely common scale of prior and noise: yᵀ(A S Aᵀ + R)⁻¹y per reading.
        let unexplained = (evidence.power - mean.dot(&evidence.moment)).max(0.0) / noise_variance;
        let scale = unexplained / evidence.readings.max(1.0);
        Self { mean, covariance: covariance * scale }
    }
}
