//! Physically possible masses and inertias: the pseudo-inertia of each body is positive definite (Wensing, Kim and
//! Slotine 2018), that is, the body can be made of point masses.
//!
//! ```text
//! J = [ ½ tr(I)·1 − I    m·c ]
//!     [    (m·c)ᵀ         m  ]
//! ```
//!
//! The barrier `− WEIGHT · log det J` is added to the negative log posterior. It keeps every step inside the possible
//! region, and hardly changes parameters that the data determine. Newton's method starts from the URDF with a much
//! larger weight, and follows the optimum while the weight is lowered.

use nalgebra::{DMatrix, DVector, Matrix4};
use palpate::unstable::N_INERTIAL_PARAMETERS;

/// Final weight of the barrier, in units of the log likelihood.
const WEIGHT: f64 = 0.05;
/// Least weight to start with, factor of each reduction, and most Newton steps at each weight.
const FIRST_WEIGHT: f64 = 1e6;
const LOWER: f64 = 0.3;
const STEPS: usize = 20;

/// The pseudo-inertia of ten inertial parameters, in which it is linear.
fn pseudo_inertia(parameters: &[f64]) -> Matrix4<f64> {
    let &[m, x, y, z, xx, xy, xz, yy, yz, zz] = parameters else {
        unreachable!("ten numbers a body")
    };
    let half = 0.5 * (xx + yy + zz);
    Matrix4::new(half - xx, -xy, -xz, x, -xy, half - yy, -yz, y, -xz, -yz, half - zz, z, x, y, z, m)
}

/// Whether ten inertial parameters are physically possible.
pub(super) fn is_physically_consistent(parameters: &[f64]) -> bool {
    pseudo_inertia(parameters).cholesky().is_some()
}

/// Inertial parameters of a homogeneous ball.
fn ball(mass: f64, radius: f64, center: [f64; 3]) -> [f64; N_INERTIAL_PARAMETERS] {
    let [x, y, z] = center;
    let own = 0.4 * mass * radius * radius;
    [
        mass,
        mass * x,
        mass * y,
        mass * z,
        own + mass * (y * y + z * z),
        -mass * x * y,
        -mass * x * z,
        own + mass * (x * x + z * z),
        -mass * y * z,
        own + mass * (x * x + y * y),
    ]
}

/// The most probable parameters that are physically possible: changes of the bodies' parameters, then the ten of the
/// payload.
///
/// `mean` and `precision` (inverse covariance) are of the same numbers; `urdf` and `scales` are of the bodies only.
pub(super) fn nearest(
    mean: &DVector<f64>,
    precision: &DMatrix<f64>,
    urdf: &DVector<f64>,
    scales: &DVector<f64>,
) -> DVector<f64> {
    let n = urdf.len();
    // A URDF may have bodies without mass, or with impossible inertias: small balls are added until all are possible.
    let mut base = DVector::zeros(mean.len());
    base.rows_mut(0, n).copy_from(urdf);
    for body in 0..n / N_INERTIAL_PARAMETERS {
        let at = N_INERTIAL_PARAMETERS * body;
        let (mass, square) = (scales[at], scales[at + 4] / scales[at]);
        let speck = ball(1e-4 * mass, square.sqrt(), [0.0; 3]);
        let mut more = 1.0;
        while !is_physically_consistent(base.rows(at, N_INERTIAL_PARAMETERS).as_slice())
            && more < 1e6
        {
            for (k, part) in speck.iter().enumerate() {
                base[at + k] = urdf[at + k] + more * part;
            }
            more *= 2.0;
        }
    }
    let mut now = DVector::zeros(mean.len());
    now.rows_mut(n, N_INERTIAL_PARAMETERS).copy_from_slice(&ball(0.05, 0.05, [0.0; 3]));
    let units: Vec<Matrix4<f64>> = (0..N_INERTIAL_PARAMETERS)
        .map(|k| {
            let mut unit = [0.0; N_INERTIAL_PARAMETERS];
            unit[k] = 1.0;
            pseudo_inertia(&unit)
        })
        .collect();
    // The weight is at least the cost at the start: with a lower one, Newton's steps near the boundary would be short.
    let off = &now - mean;
    let mut weight = FIRST_WEIGHT.max(off.dot(&(precision * &off)));
    loop {
        now = lower(now, weight, (mean, precision, &base), &units);
        if weight <= WEIGHT {
            return now;
        }
        weight = (weight * LOWER).max(WEIGHT);
    }
}

/// The optimum under a barrier of this weight, by Newton's method from a possible point.
fn lower(
    mut now: DVector<f64>,
    weight: f64,
    (mean, precision, base): (&DVector<f64>, &DMatrix<f64>, &DVector<f64>),
    units: &[Matrix4<f64>],
) -> DVector<f64> {
    let blocks = mean.len() / N_INERTIAL_PARAMETERS;
    let body = |at: &DVector<f64>, block: usize| {
        let own = N_INERTIAL_PARAMETERS * block..N_INERTIAL_PARAMETERS * (block + 1);
        pseudo_inertia(&own.map(|k| base[k] + at[k]).collect::<Vec<_>>())
    };
    let cost = |at: &DVector<f64>| -> Option<f64> {
        let off = at - mean;
        let mut cost = 0.5 * off.dot(&(precision * &off));
        for block in 0..blocks {
            let factor = body(at, block).cholesky()?;
            cost -= weight * 2.0 * factor.l_dirty().diagonal().map(f64::ln).sum();
        }
        Some(cost)
    };
    let Some(mut best) = cost(&now) else { return now };
    for _ in 0..STEPS {
        let mut gradient = precision * (&now - mean);
        let mut hessian = precision.clone();
        for block in 0..blocks {
            let at = N_INERTIAL_PARAMETERS * block;
            let Some(inverse) = body(&now, block).try_inverse() else { return now };
            let turned: Vec<Matrix4<f64>> = units.iter().map(|unit| inverse * unit).collect();
            for a in 0..N_INERTIAL_PARAMETERS {
                gradient[at + a] -= weight * turned[a].trace();
                for b in 0..N_INERTIAL_PARAMETERS {
                    hessian[(at + a, at + b)] += weight * (turned[a] * turned[b]).trace();
                }
            }
        }
        let Some(factor) = hessian.cholesky() else { return now };
        let step = factor.solve(&gradient);
        let decrement = gradient.dot(&step);
        let mut length = 1.0;
        while length > 1e-6 {
            let next = &now - length * &step;
            if let Some(less) = cost(&next).filter(|less| *less < best) {
                (now, best) = (next, less);
                break;
            }
            length *= 0.5;
        }
        if decrement < 1e-6 * weight.max(1.0) || length <= 1e-6 {
            break;
        }
    }
    now
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masses_that_are_possible_and_known_stay() {
        let body = ball(2.0, 0.1, [0.1, 0.0, -0.05]);
        let urdf = DVector::from_column_slice(&body);
        let scales = DVector::from_fn(10, |k, _| {
            if k == 0 {
                2.0
            } else if k < 4 {
                0.3
            } else {
                0.05
            }
        });
        let mut mean = DVector::zeros(20);
        mean.rows_mut(10, 10).copy_from_slice(&ball(1.0, 0.05, [0.0, 0.02, 0.1]));
        let found = nearest(&mean, &(DMatrix::identity(20, 20) * 1e10), &urdf, &scales);
        assert!((&found - &mean).amax() < 1e-5, "{found}");
    }

    #[test]
    fn a_negative_mass_becomes_a_small_one() {
        let urdf = DVector::from_column_slice(&ball(2.0, 0.1, [0.1, 0.0, -0.05]));
        let scales = DVector::from_element(10, 0.1);
        let mut mean = DVector::zeros(20);
        (mean[0], mean[10]) = (-2.5, -0.3);
        let found = nearest(&mean, &(DMatrix::identity(20, 20) * 1e4), &urdf, &scales);
        let whole = &urdf + found.rows(0, 10);
        assert!(
            is_physically_consistent(whole.as_slice())
                && is_physically_consistent(found.rows(10, 10).into_owned().as_slice())
        );
        assert!(whole[0] > 0.0 && whole[0] < 0.1, "{whole}");
    }
}
