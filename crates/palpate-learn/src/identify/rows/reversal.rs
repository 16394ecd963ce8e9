//! Friction at reversals of a joint: the presliding distance and the Stribeck speed, at which breakaway has fallen to
//! 1/e. Both are chosen so that friction explains most of the residual of the rest of the model.

use palpate::JointFriction;
use rayon::prelude::*;

use super::{BIAS, FRICTION, MAX_UNKNOWN, Row, Rows, SLOPES};
use crate::identify::posterior::Posterior;

/// Presliding distances, rad, and Stribeck speeds, rad/s, that are tried.
const PRESLIDING: [f64; 10] = [0.0, 2e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 4e-3, 8e-3, 1.6e-2];
const STRIBECK: [f64; 5] = [0.01, 0.017, 0.03, 0.05, 0.1];
/// Factors of the presliding distance found last, which are tried too.
const NEAR: [f64; 6] = [0.7, 0.85, 0.95, 1.05, 1.2, 1.4];

/// Friction of a joint at reversals: presliding distance, rad, and Stribeck speed, rad/s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::identify) struct FrictionReversal {
    pub(in crate::identify) presliding: f64,
    pub(in crate::identify) stribeck: f64,
}

impl FrictionReversal {
    /// Whether the presliding distances differ by at most a factor of 1.5, or are both tiny.
    pub(in crate::identify) fn is_near(&self, other: &Self) -> bool {
        let [least, most] = [f64::min, f64::max].map(|of| of(self.presliding, other.presliding));
        most <= 1.5 * least || most <= PRESLIDING[2]
    }
}

impl Rows {
    /// Presliding distance and Stribeck speed of each joint that explain most of the residual of the rest of the model.
    pub(in crate::identify) fn best_turning(&self, posterior: &Posterior) -> Vec<FrictionReversal> {
        (0..self.n_joints)
            .into_par_iter()
            .map(|j| {
                let mut coefficients = posterior.row_coefficients(j);
                // The residual without Coulomb friction, asymmetry, breakaway and the slopes.
                coefficients.rows_mut(self.n_parameters + 1, 3).fill(0.0);
                let slopes = self.n_parameters + 1 + FRICTION + BIAS;
                coefficients.rows_mut(slopes, SLOPES).fill(0.0);
                let left: Vec<(&Row, f64)> = (self.rows.iter())
                    .filter(|row| !row.is_touched)
                    .map(|row| (row, self.numbers(row, j).dot(&coefficients)))
                    .collect();
                let now = self.turning[j];
                let near = NEAR.map(|factor| factor * now.presliding);
                let tried = PRESLIDING.iter().chain(&near).chain([&now.presliding]);
                let tried = tried.map(|presliding| {
                    let states = self.states(&left, j, *presliding);
                    let costs = STRIBECK.map(|stribeck| {
                        let cost = self.cost(&left, (&states, j), stribeck);
                        (cost, FrictionReversal { presliding: *presliding, stribeck })
                    });
                    costs.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).expect("there are some")
                });
                let best = tried.min_by(|a, b| a.0.total_cmp(&b.0)).expect("there are some");
                if best.0.is_finite() { best.1 } else { now }
            })
            .collect()
    }

    /// Friction states at rows, for this presliding distance; `None` where the state is not known.
    fn states(&self, rows: &[(&Row, f64)], j: usize, presliding: f64) -> Vec<Option<f64>> {
        let states: Vec<_> =
            self.motions.iter().map(|motion| motion.friction_of(j, presliding)).collect();
        let at = |row: &Row| {
            let states = (&states[row.touch][..], presliding);
            let state = self.motions[row.touch].friction_at(row.time_s, j, states);
            (state.unknown() <= MAX_UNKNOWN).then(|| state.middle())
        };
        rows.iter().map(|(row, _)| at(row)).collect()
    }

    /// Mean squared residual after a fit of Coulomb friction, asymmetry and breakaway in these states.
    fn cost(
        &self,
        left: &[(&Row, f64)],
        (states, j): (&[Option<f64>], usize),
        stribeck: f64,
    ) -> f64 {
        let mut gram = nalgebra::Matrix3::<f64>::zeros();
        let mut right = nalgebra::Vector3::<f64>::zeros();
        let (mut power, mut rows) = (0.0, 0.0);
        for ((row, over), z) in left.iter().zip(states) {
            let Some(z) = *z else { continue };
            let factors = JointFriction::factors(z, row.motion.speed[j], stribeck);
            let own = nalgebra::Vector3::new(factors[0], factors[1], factors[2]);
            gram += own * own.transpose();
            right += own * *over;
            power += over * over;
            rows += 1.0;
        }
        if rows < 10.0 {
            return f64::INFINITY;
        }
        gram += nalgebra::Matrix3::identity() * (1e-3 * rows);
        let explained = gram.cholesky().map_or(0.0, |factor| right.dot(&factor.solve(&right)));
        (power - explained) / rows
    }
}
