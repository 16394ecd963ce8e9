//! Prior, evidence and posterior of the regression.
//!
//! What is solved for, in this order:
//!
//! ```text
//! [ Δπ (10 · n_bodies) | payload (10) | delay | by joint: gain − 1, friction and drive, bias, slopes, offset and drift by touch ]
//! ```
//!
//! All have Gaussian priors around zero (gains of currents: around their first estimate). Those of one *group* have one
//! unknown width, relative to scales that are the arm's: it, and the noise of each joint, are set to what makes the
//! data most probable, by the fixed point of MacKay (1992).

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use palpate::Robot;
use palpate::unstable::BODY_PARAMETERS;

use super::possible;
use super::rows::{BIAS, FRICTION, Rows, SLOPES, Sum};

/// Steps of the fixed point.
const STEPS: usize = 25;
/// Joints of which nobody knows the largest torque are taken to have this one, N·m.
const USUAL_EFFORT: f64 = 40.0;

/// Groups of coefficients that share a width, with that to start from and its bounds.
const GROUPS: [(f64, [f64; 2]); 8] = [
    (0.05, [0.003, 0.5]),  // masses of links
    (0.02, [1e-3, 0.5]),   // Coulomb friction
    (0.01, [1e-4, 0.3]),   // asymmetry, breakaway
    (0.02, [1e-4, 0.5]),   // viscous friction
    (0.005, [1e-4, 0.1]),  // drives' inertia
    (0.01, [1e-4, 0.3]),   // bias
    (0.003, [1e-5, 0.1]),  // bias by pose, offsets and drifts
    (0.01, [0.002, 0.05]), // gains
];
const LINKS: usize = 0;
const GAIN: usize = 7;
/// Group of each coefficient of a joint after its gain: friction and drive, bias.
const OF_JOINT: [usize; FRICTION + BIAS + SLOPES] = [1, 2, 2, 3, 4, 5, 6, 6, SLOPE, SLOPE];
/// Not a group: how much of the Coulomb friction the slopes' coefficients may be.
const SLOPE: usize = usize::MAX - 1;
const SLOPE_N_M: f64 = 0.01;
const OF_TOUCH: usize = 6;

/// Widths that are not estimated: payload, kg and m; delay, s.
const PAYLOAD_KG: f64 = 5.0;
const PAYLOAD_M: f64 = 0.2;
const DELAY_S: f64 = 0.05;

/// What the regression starts from.
pub(super) struct Start {
    /// π of the URDF.
    pub(super) parameters: DVector<f64>,
    /// Scale of each of them.
    scales: DVector<f64>,
    /// Largest torques, N·m.
    efforts: Vec<f64>,
    pub(super) payload_body: usize,
    currents: bool,
}

impl Start {
    pub(super) fn of(robot: &Robot, payload_body: usize, currents: bool) -> Self {
        let parameters = robot.inertial_parameters();
        let bodies = robot.bodies().len();
        let mean_mass =
            (0..bodies).map(|body| parameters[BODY_PARAMETERS * body]).sum::<f64>() / bodies as f64;
        let mut scales = DVector::zeros(parameters.len());
        for body in 0..bodies {
            let own = parameters.rows(BODY_PARAMETERS * body, BODY_PARAMETERS);
            let mass = own[0].max(0.1 * mean_mass).max(1e-3);
            let length = (0.5 * (own[4] + own[7] + own[9]).max(0.0) / mass).sqrt() + 0.03;
            let by = [mass, mass * length, mass * length * length];
            for k in 0..BODY_PARAMETERS {
                scales[BODY_PARAMETERS * body + k] = by[match k {
                    0 => 0,
                    1..=3 => 1,
                    _ => 2,
                }];
            }
        }
        let efforts =
            robot.joints().iter().map(|joint| joint.effort.unwrap_or(USUAL_EFFORT)).collect();
        Self { parameters, scales, efforts, payload_body, currents }
    }
}

/// What the data say.
pub(super) struct Posterior {
    n_parameters: usize,
    n_joints: usize,
    of_joint: usize,
    start_parameters: DVector<f64>,
    payload_body: usize,
    /// Mean and covariance of all that is solved for.
    pub(super) mean: DVector<f64>,
    pub(super) covariance: DMatrix<f64>,
    /// Noise of a row, N·m, by joint.
    pub(super) noise: Vec<f64>,
    /// What the noise is relative to.
    efforts: Vec<f64>,
    /// How many rows say the same.
    correlated: Vec<f64>,
    /// Widths of the links' masses before and after.
    pub(super) prior_variance: DVector<f64>,
}

impl Posterior {
    /// `None` if the numbers cannot be solved for.
    pub(super) fn of(rows: &Rows, sums: &[Sum], start: &Start) -> Option<Self> {
        let mut correlated = vec![1.0; rows.n_joints()];
        for _ in 0..2 {
            correlated = rows.correlated(&Self::with(rows, sums, start, correlated)?);
        }
        Self::with(rows, sums, start, correlated)
    }

    fn with(rows: &Rows, sums: &[Sum], start: &Start, correlated: Vec<f64>) -> Option<Self> {
        let (n, width) = (rows.n_joints(), rows.width());
        let of_joint = 1 + FRICTION + BIAS + SLOPES + 2 * rows.offsets;
        let shared = rows.n_parameters + BODY_PARAMETERS + 1;
        let size = shared + n * of_joint;

        // Width of each prior: of a group, or fixed; gains of currents are relative to a first estimate.
        let gains = start.first_gains(rows, sums);
        let mut group = vec![usize::MAX; size];
        let mut scale = DVector::zeros(size);
        for k in 0..rows.n_parameters {
            (group[k], scale[k]) = (LINKS, start.scales[k]);
        }
        for k in 0..BODY_PARAMETERS {
            scale[rows.n_parameters + k] =
                PAYLOAD_KG * PAYLOAD_M.powi([0, 1, 1, 1, 2, 2, 2, 2, 2, 2][k]);
        }
        scale[shared - 1] = DELAY_S;
        for j in 0..n {
            let at = shared + j * of_joint;
            (group[at], scale[at]) = (GAIN, gains[j].abs());
            for k in 0..FRICTION + BIAS + SLOPES + 2 * rows.offsets {
                group[at + 1 + k] = OF_JOINT.get(k).copied().unwrap_or(OF_TOUCH);
                let slope = if group[at + 1 + k] == SLOPE { SLOPE_N_M } else { 1.0 };
                scale[at + 1 + k] = slope * start.efforts[j] * gains[j].abs();
            }
        }
        let mut widths = GROUPS.map(|(width, _)| width);
        if start.currents {
            widths[GAIN] = 0.3;
        }
        let mut center = DVector::zeros(size);
        gains.iter().enumerate().for_each(|(j, gain)| center[shared + j * of_joint] = gain - 1.0);

        let mut posterior = Self {
            n_parameters: rows.n_parameters,
            n_joints: n,
            of_joint,
            start_parameters: start.parameters.clone(),
            payload_body: start.payload_body,
            mean: center.clone(),
            covariance: DMatrix::zeros(0, 0),
            noise: start
                .efforts
                .iter()
                .zip(&gains)
                .map(|(effort, gain)| 0.01 * effort * gain.abs())
                .collect(),
            efforts: start
                .efforts
                .iter()
                .zip(&gains)
                .map(|(effort, gain)| effort * gain.abs())
                .collect(),
            correlated,
            prior_variance: DVector::zeros(size),
        };
        let mut is_zero = vec![false; size];
        for step in 0..STEPS {
            if step == STEPS / 2 || step == 3 * STEPS / 4 {
                // Friction and inertia of a drive are never below zero.
                for (j, k) in (0..n).flat_map(|j| [0, 3, 4].map(|k| (j, k))) {
                    let at = shared + j * of_joint + 1 + k;
                    is_zero[at] |= posterior.mean[at] * gains[j] < 0.0;
                }
            }
            for k in 0..size {
                let width = widths.get(group[k]).copied().unwrap_or(1.0);
                let width = if is_zero[k] { 1e-3 * width } else { width };
                posterior.prior_variance[k] = (width * scale[k]).powi(2);
            }
            let mut precision = DMatrix::from_diagonal(&posterior.prior_variance.map(|v| 1.0 / v));
            let mut right = center.component_div(&posterior.prior_variance);
            let designs: Vec<DMatrix<f64>> = (0..n).map(|j| posterior.design(j, width)).collect();
            let mut grams = Vec::with_capacity(n);
            for j in 0..n {
                let gram = &designs[j] * &sums[j].gram * designs[j].transpose();
                let weight = 1.0 / (posterior.noise[j].powi(2) * posterior.correlated[j]);
                posterior.add(j, &gram, weight, (&mut precision, &mut right));
                grams.push(gram);
            }
            let factor: Cholesky<f64, Dyn> = precision.cholesky()?;
            posterior.mean = factor.solve(&right);
            posterior.covariance = factor.inverse();

            // Noise: what is left over, and what the uncertain coefficients may leave over.
            for j in 0..n {
                let own = posterior.own(j);
                let mut with_target = DVector::zeros(own.len() + 1);
                own.iter().enumerate().for_each(|(k, at)| with_target[k] = -posterior.mean[*at]);
                with_target[own.len()] = 1.0;
                let squares = with_target.dot(&(&grams[j] * &with_target));
                let told: f64 = (0..own.len())
                    .map(|a| {
                        let row = (0..own.len())
                            .map(|b| grams[j][(a, b)] * posterior.covariance[(own[a], own[b])]);
                        row.sum::<f64>()
                    })
                    .sum();
                if sums[j].rows > 0.0 {
                    let variance = (squares.max(0.0) + told) / sums[j].rows;
                    posterior.noise[j] = variance.sqrt().max(1e-5 * posterior.efforts[j]).max(1e-9);
                }
            }
            for (index, (_, bounds)) in GROUPS.iter().enumerate() {
                let members = || (0..size).filter(|k| group[*k] == index && !is_zero[*k]);
                // MacKay's: what the coefficients are, by how many of them the data tell.
                let square: f64 =
                    members().map(|k| ((posterior.mean[k] - center[k]) / scale[k]).powi(2)).sum();
                let told: f64 = members()
                    .map(|k| 1.0 - posterior.covariance[(k, k)] / posterior.prior_variance[k])
                    .sum();
                if told > 0.1 && !(index == GAIN && start.currents) {
                    let found = (square / told).sqrt().clamp(bounds[0], bounds[1]);
                    widths[index] = (widths[index] * found).sqrt();
                }
            }
        }
        posterior.make_possible(start)?;
        posterior.mean.iter().all(|value| value.is_finite()).then_some(posterior)
    }

    /// Where the coefficients of a joint's rows are: shared ones and its own.
    fn own(&self, j: usize) -> Vec<usize> {
        let shared = self.shared();
        let at = shared + j * self.of_joint;
        (0..shared).chain(at..at + self.of_joint).collect()
    }

    pub(super) fn shared(&self) -> usize {
        self.n_parameters + BODY_PARAMETERS + 1
    }

    pub(super) fn payload_body(&self) -> usize {
        self.payload_body
    }

    /// Where the coefficients of a joint begin: its gain, less 1.
    pub(super) fn joint(&self, j: usize) -> usize {
        self.shared() + j * self.of_joint
    }

    /// The inertial parameters, payload included.
    pub(super) fn parameters(&self) -> DVector<f64> {
        let mut parameters = &self.start_parameters + self.mean.rows(0, self.n_parameters);
        let mut body = parameters.rows_mut(BODY_PARAMETERS * self.payload_body, BODY_PARAMETERS);
        body += self.mean.rows(self.n_parameters, BODY_PARAMETERS);
        parameters
    }

    /// Delay that is left, and its standard deviation, s.
    pub(super) fn delay(&self) -> (f64, f64) {
        let at = self.shared() - 1;
        (self.mean[at], self.covariance[(at, at)].sqrt())
    }

    /// Gain of a joint.
    pub(super) fn gain(&self, j: usize) -> f64 {
        1.0 + self.mean[self.joint(j)]
    }

    /// The mean bias of a joint over the logs, as a sum of coefficients with these factors.
    pub(super) fn mean_bias(&self, j: usize) -> Vec<(usize, f64)> {
        let at = self.joint(j) + 1;
        let touches = at + FRICTION + BIAS + SLOPES..at + self.of_joint - 1;
        let count = touches.len() as f64 / 2.0;
        let offsets = touches.step_by(2).map(|k| (k, -1.0 / count));
        std::iter::once((at + FRICTION, -1.0)).chain(offsets).collect()
    }

    /// Numbers of a row of `rows` as those of the linearised regression, with its target last: the matrix that does it.
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
        for k in 0..BODY_PARAMETERS {
            design[(self.n_parameters + k, BODY_PARAMETERS * self.payload_body + k)] = gain;
        }
        design[(self.shared() - 1, self.n_parameters)] = 1.0;
        for k in 1..self.of_joint {
            design[(self.shared() + k, self.n_parameters + k)] = 1.0;
        }
        design[(own, width - 1)] = 1.0;
        design
    }

    /// What is left over of a row of `rows`, as coefficients of its numbers.
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

    fn add(
        &self,
        j: usize,
        gram: &DMatrix<f64>,
        weight: f64,
        to: (&mut DMatrix<f64>, &mut DVector<f64>),
    ) {
        let own = self.own(j);
        for (a, row) in own.iter().enumerate() {
            for (b, column) in own.iter().enumerate() {
                to.0[(*row, *column)] += weight * gram[(a, b)];
            }
            to.1[*row] += weight * gram[(a, own.len())];
        }
    }

    /// Moves the masses to where they are possible, and all else to where it is most probable then.
    fn make_possible(&mut self, start: &Start) -> Option<()> {
        let count = self.n_parameters + BODY_PARAMETERS;
        let covariance = self.covariance.view((0, 0), (count, count)).into_owned();
        let precision = covariance.cholesky()?.inverse();
        let mean = self.mean.rows(0, count).into_owned();
        let moved = possible::nearest(&mean, &precision, &start.parameters, &start.scales);
        let pull = &precision * (&moved - &mean);
        self.mean += self.covariance.columns(0, count) * pull;
        Some(())
    }

    /// Variance that is left over, relative to the joints' largest torques.
    pub(super) fn left_over(&self) -> f64 {
        self.noise.iter().zip(&self.efforts).map(|(noise, effort)| (noise / effort).powi(2)).sum()
    }

    pub(super) fn n_joints(&self) -> usize {
        self.n_joints
    }
}

impl Start {
    /// Gains to start from: 1, or, of currents, the slope on what the URDF says.
    fn first_gains(&self, rows: &Rows, sums: &[Sum]) -> Vec<f64> {
        if !self.currents {
            return vec![1.0; sums.len()];
        }
        let (last, one) = (rows.width() - 1, rows.n_parameters + 1 + FRICTION);
        let slope = |sum: &Sum| {
            let mut urdf = DVector::zeros(rows.width());
            urdf.rows_mut(0, rows.n_parameters).copy_from(&self.parameters);
            let with = &sum.gram * &urdf;
            let count = sum.rows.max(1.0);
            let covariance = with[last] - with[one] * sum.gram[(last, one)] / count;
            let variance = urdf.dot(&with) - with[one] * with[one] / count;
            // A joint that gravity hardly moves tells nothing.
            (variance > 0.01 * count).then(|| covariance / variance)
        };
        let slopes: Vec<Option<f64>> = sums.iter().map(slope).collect();
        let known: Vec<f64> =
            slopes.iter().flatten().copied().filter(|slope| slope.abs() > 1e-4).collect();
        let mean =
            if known.is_empty() { 1.0 } else { known.iter().sum::<f64>() / known.len() as f64 };
        let gain = |slope: Option<f64>| slope.filter(|slope| slope.abs() > 1e-4).unwrap_or(mean);
        slopes.into_iter().map(gain).collect()
    }
}
