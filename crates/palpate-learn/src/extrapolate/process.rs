//! Stiffness as a Gaussian process over features, learnt from whatever is linear in it.
//!
//! `K(x) = φ(x)·w + 3c`, w and c of variance a² each, and readings `y = A·(w, c, …) + noise`. The
//! posterior is that of linear regression; [`super::torque_evidence`] and [`super::cells`] say what is read.
//! Its spread is scaled by how well the readings were met, so that twice the torques give twice the
//! stiffness and twice the standard deviation.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::basis::Basis;

/// How much larger what all points have in common may be than how they differ: of a colour that no
/// touch has met the common stiffness is expected, rather than none.
const IN_COMMON: f64 = 3.0;

/// Points worked on at once.
const BLOCK: usize = 4096;

/// Features of all seen points, and the functions of them that may be learnt.
pub(super) struct Process {
    features: DMatrix<f64>,
    basis: Basis,
}

/// What some readings say: sums that are enough for regression.
#[derive(Debug, Clone)]
pub(super) struct Evidence {
    /// `Σ a aᵀ` of rows a of A, weighted.
    pub(super) gram: DMatrix<f64>,
    /// `Σ a y`.
    pub(super) moment: DVector<f64>,
    /// `Σ y²`.
    pub(super) power: f64,
    /// Readings that these count for.
    pub(super) readings: f64,
}

/// What is believed of w after the readings.
#[derive(Debug, Clone)]
pub(super) struct Posterior {
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
}

impl Process {
    /// Over features, n_features × points, that matter as far apart as `length_scale`.
    pub(super) fn new(features: DMatrix<f64>, length_scale: f64) -> Self {
        let basis = Basis::new(&features, length_scale);
        Self { features, basis }
    }

    /// Numbers in w, and one for c.
    pub(super) fn len(&self) -> usize {
        self.basis.len() + 1
    }

    /// One function of the point before whitening, none of them negative: its covariance with a
    /// pivot, or what all have in common for the last.
    pub(super) fn covariance_with(&self, function: usize, points: &[u32]) -> Vec<f64> {
        if function == self.basis.len() {
            return vec![IN_COMMON; points.len()];
        }
        let of = |&point: &u32| self.basis.covariance_with(function, &self.column(point as usize));
        points.iter().map(of).collect()
    }

    /// `(φ(x), 3)` of some points, column by column.
    pub(super) fn phi(&self, points: impl ExactSizeIterator<Item = usize>) -> DMatrix<f64> {
        let mut k = DMatrix::zeros(self.basis.len(), points.len());
        for (point, mut column) in points.zip(k.column_iter_mut()) {
            column.copy_from(&self.basis.covariances(&self.column(point)));
        }
        let n = k.nrows();
        self.basis.whitened(k).insert_row(n, IN_COMMON)
    }

    /// Evidence over covariances as evidence over φ; what follows them in A stays.
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
    /// Of nothing, for so many unknowns.
    pub(super) fn none(unknowns: usize) -> Self {
        Self {
            gram: DMatrix::zeros(unknowns, unknowns),
            moment: DVector::zeros(unknowns),
            power: 0.0,
            readings: 0.0,
        }
    }

    /// Adds what other readings say.
    pub(super) fn add(&mut self, other: &Self) {
        self.gram += &other.gram;
        self.moment += &other.moment;
        self.power += other.power;
        self.readings += other.readings;
    }
}

impl Posterior {
    /// Of unknowns with a standard deviation before, given evidence with a noise.
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
        // The likeliest common scale of prior and noise: yᵀ(A S Aᵀ + R)⁻¹y a reading.
        let unexplained = (evidence.power - mean.dot(&evidence.moment)).max(0.0) / noise_variance;
        let scale = unexplained / evidence.readings.max(1.0);
        Self { mean, covariance: covariance * scale }
    }
}
