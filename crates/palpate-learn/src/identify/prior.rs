//! Priors of the unknowns of the regression, in the order of [`super::posterior`].
//!
//! All are Gaussian around zero (gains of currents: around their first estimate). The standard deviation is a *width*
//! times a scale that is known from the arm. The coefficients of one *group* share a width, which maximises the
//! evidence, by the fixed point of MacKay (1992).

use nalgebra::DVector;
use palpate::Robot;
use palpate::unstable::N_INERTIAL_PARAMETERS;

use super::posterior::Posterior;
use super::rows::{BIAS, FRICTION, Rows, SLOPES, Sum};

/// Largest torque of a joint whose URDF gives none, N·m.
const USUAL_EFFORT: f64 = 40.0;

/// Groups of coefficients that share a width: the first width and its bounds. No URDF is taken to be better than 1 %,
/// no gain better than 0.5 %.
const GROUPS: [(f64, [f64; 2]); 8] = [
    (0.05, [0.01, 0.5]),   // masses of links
    (0.02, [1e-3, 0.5]),   // Coulomb friction
    (0.01, [1e-4, 0.3]),   // asymmetry, breakaway
    (0.02, [1e-4, 0.5]),   // viscous friction
    (0.005, [1e-4, 0.1]),  // inertia of the drives
    (0.01, [1e-4, 0.3]),   // bias
    (0.003, [1e-5, 0.1]),  // bias by pose, offsets and drifts
    (0.01, [0.005, 0.05]), // gains
];
const LINKS: usize = 0;
const GAIN: usize = 7;
/// Group of each coefficient of a joint after its gain: friction and drive, bias.
const OF_JOINT: [usize; FRICTION + BIAS + SLOPES] = [1, 2, 2, 3, 4, 5, 6, 6, SLOPE, SLOPE];
/// Not a group: slopes of friction, whose width is [`SLOPE_WIDTH`] and not estimated.
const SLOPE: usize = usize::MAX - 1;
/// Not a group: unknowns whose width is not estimated.
const FIXED: usize = usize::MAX;
/// Indices, after the gain, of the coefficients that are never below zero: Coulomb, viscous, drive.
pub(super) const NEVER_NEGATIVE: [usize; 3] = [0, 3, 4];
/// Effective number of coefficients of a group that the data must determine before its width is estimated.
const MIN_DETERMINED: f64 = 0.1;
/// Width of the slopes of friction, relative to the largest torque.
const SLOPE_WIDTH: f64 = 0.01;
/// Group of the offsets and drifts by touch.
const OF_TOUCH: usize = 6;

/// Width of the gains of currents, relative to their first estimate.
const GAIN_OF_CURRENT: f64 = 1.0;
/// Largest ratio, or inverse ratio, of a joint's first gain to the gain that is common to all joints.
const MAX_RATIO: f64 = 3.0;
/// Standard deviations that are not estimated: mass, kg, and size, m, of the payload; delay, s.
const PAYLOAD_KG: f64 = 5.0;
const PAYLOAD_M: f64 = 0.2;
const DELAY_S: f64 = 0.05;

/// What is known of the arm before the regression.
pub(super) struct Start {
    /// Inertial parameters π of the URDF.
    pub(super) parameters: DVector<f64>,
    /// Scale of each of them ([`inertial_scales`]).
    pub(super) scales: DVector<f64>,
    /// Largest torque of each joint, N·m.
    pub(super) efforts: Vec<f64>,
    pub(super) payload_body: usize,
    currents: bool,
}

impl Start {
    pub(super) fn of(robot: &Robot, payload_body: usize, currents: bool) -> Self {
        let parameters = robot.inertial_parameters();
        let scales = inertial_scales(&parameters);
        let efforts =
            robot.joints().iter().map(|joint| joint.effort.unwrap_or(USUAL_EFFORT)).collect();
        Self { parameters, scales, efforts, payload_body, currents }
    }
}

/// Scale of each inertial parameter: the mass of its body, times a length near its radius of gyration for first
/// moments, and the square of this length for second moments. The mass counts as at least a tenth of the mean mass.
pub(crate) fn inertial_scales(parameters: &DVector<f64>) -> DVector<f64> {
    let bodies = || parameters.as_slice().chunks(N_INERTIAL_PARAMETERS);
    let mean_mass = bodies().map(|body| body[0]).sum::<f64>() / bodies().len().max(1) as f64;
    let of_body = |body: &[f64]| {
        let mass = body[0].max(0.1 * mean_mass).max(1e-3);
        let length = (0.5 * (body[4] + body[7] + body[9]).max(0.0) / mass).sqrt() + 0.03;
        [(mass, 1), (mass * length, 3), (mass * length * length, 6)]
    };
    let scales = bodies().flat_map(of_body).flat_map(|(scale, n)| std::iter::repeat_n(scale, n));
    DVector::from_vec(scales.collect())
}

/// Number of coefficients of a joint: its gain, friction and drive, bias, slopes, offset and drift by touch.
pub(super) fn of_joint(rows: &Rows) -> usize {
    1 + FRICTION + BIAS + SLOPES + 2 * rows.offsets
}

/// Priors of all coefficients.
pub(super) struct Prior {
    pub(super) center: DVector<f64>,
    /// Largest torque of each joint, in logged units.
    pub(super) efforts: Vec<f64>,
    group: Vec<usize>,
    scale: DVector<f64>,
    widths: [f64; GROUPS.len()],
    /// Whether the torques are currents: the width of the gains is then not estimated.
    currents: bool,
    /// Coefficients that are held near zero, since their estimate would be negative.
    pub(super) is_zero: Vec<bool>,
    /// Index of each joint's first coefficient.
    joints: Vec<usize>,
}

impl Prior {
    pub(super) fn new(rows: &Rows, sums: &[Sum], start: &Start) -> Self {
        let of_joint = of_joint(rows);
        let shared = rows.n_parameters + N_INERTIAL_PARAMETERS + 1;
        let size = shared + rows.n_joints() * of_joint;
        let gains = start.first_gains(rows, sums);
        let efforts: Vec<f64> =
            start.efforts.iter().zip(&gains).map(|(effort, gain)| effort * gain.abs()).collect();
        let mut prior = Self {
            center: DVector::zeros(size),
            group: vec![FIXED; size],
            scale: DVector::zeros(size),
            widths: GROUPS.map(|(width, _)| width),
            currents: start.currents,
            is_zero: vec![false; size],
            joints: (0..gains.len()).map(|j| shared + j * of_joint).collect(),
            efforts,
        };
        if start.currents {
            prior.widths[GAIN] = GAIN_OF_CURRENT;
        }
        for k in 0..rows.n_parameters {
            (prior.group[k], prior.scale[k]) = (LINKS, start.scales[k]);
        }
        for k in 0..N_INERTIAL_PARAMETERS {
            prior.scale[rows.n_parameters + k] = payload_scale(k);
        }
        prior.scale[shared - 1] = DELAY_S;
        for (j, gain) in gains.iter().enumerate() {
            let at = prior.joints[j];
            prior.center[at] = gain - 1.0;
            (prior.group[at], prior.scale[at]) = (GAIN, gain.abs());
            for k in 1..of_joint {
                let group = OF_JOINT.get(k - 1).copied().unwrap_or(OF_TOUCH);
                let slope = if group == SLOPE { SLOPE_WIDTH } else { 1.0 };
                (prior.group[at + k], prior.scale[at + k]) = (group, slope * prior.efforts[j]);
            }
        }
        prior
    }

    /// Variance of each coefficient.
    pub(super) fn variance(&self) -> DVector<f64> {
        DVector::from_fn(self.scale.len(), |k, _| {
            let width = self.widths.get(self.group[k]).copied().unwrap_or(1.0);
            let width = if self.is_zero[k] { 1e-3 * width } else { width };
            (width * self.scale[k]).powi(2)
        })
    }

    /// Friction and inertia of a drive are never below zero: negative estimates are held near zero from now on.
    pub(super) fn hold_at_zero(&mut self, posterior: &Posterior) {
        for at in &self.joints {
            let sign = (1.0 + posterior.mean[*at]).signum();
            for k in NEVER_NEGATIVE {
                self.is_zero[at + 1 + k] |= posterior.mean[at + 1 + k] * sign < 0.0;
            }
        }
    }

    /// Updates the widths by a step of MacKay's fixed point: squared width = sum of the squared coefficients, relative
    /// to their scales, over the effective number of coefficients that the data determine.
    pub(super) fn adapt(&mut self, posterior: &Posterior) {
        let variance = self.variance();
        for (index, (_, [least, most])) in GROUPS.iter().enumerate() {
            if index == GAIN && self.currents {
                continue;
            }
            let (mut square, mut determined) = (0.0, 0.0);
            for k in (0..self.scale.len()).filter(|k| self.group[*k] == index && !self.is_zero[*k])
            {
                square += ((posterior.mean[k] - self.center[k]) / self.scale[k]).powi(2);
                determined += 1.0 - posterior.covariance[(k, k)] / variance[k];
            }
            if determined > MIN_DETERMINED {
                let found = f64::sqrt(square / determined).clamp(*least, *most);
                self.widths[index] = (self.widths[index] * found).sqrt();
            }
        }
    }
}

impl Start {
    /// First gains: 1; of currents, the slope of the logged on the URDF's torque over all joints, mixed with a joint's
    /// own slope, which counts more the larger the URDF's torque is against friction and a still unknown payload.
    fn first_gains(&self, rows: &Rows, sums: &[Sum]) -> Vec<f64> {
        if !self.currents {
            return vec![1.0; sums.len()];
        }
        let (last, one) = (rows.width() - 1, rows.n_parameters + 1 + FRICTION);
        // Variance of the URDF's torque, its covariance with the logged torque, variance of the logged torque, and
        // variance that a payload may add.
        let moments = |sum: &Sum| {
            let mut urdf = DVector::zeros(rows.width());
            urdf.rows_mut(0, rows.n_parameters).copy_from(&self.parameters);
            let with = &sum.gram * &urdf;
            let count = sum.rows.max(1.0);
            let about_mean = |a: usize, b: usize| {
                (sum.gram[(a, b)] - sum.gram[(a, one)] * sum.gram[(b, one)] / count) / count
            };
            let payload = (0..N_INERTIAL_PARAMETERS).map(|k| {
                let at = N_INERTIAL_PARAMETERS * self.payload_body + k;
                about_mean(at, at) * payload_scale(k).powi(2)
            });
            let covariance = (with[last] - with[one] * sum.gram[(last, one)] / count) / count;
            let variance = (urdf.dot(&with) - with[one] * with[one] / count) / count;
            [variance, covariance, about_mean(last, last), payload.sum()]
        };
        let moments: Vec<[f64; 4]> = sums.iter().map(moments).collect();
        let total = |of: usize| moments.iter().map(|own| own[of]).sum::<f64>();
        let common = total(1) / total(0).max(1e-9);
        let common = if common.abs() > 1e-4 { common } else { 1.0 };
        let gain = |[variance, covariance, logged, payload]: &[f64; 4]| {
            // The floor keeps the slope small for a joint whose gravity torque hardly changes.
            let own = covariance / variance.max(0.01);
            let friction = (logged - own * covariance).max(0.0) / common.powi(2);
            let part = variance / (variance + friction + payload).max(1e-9);
            let ratio = part * own / common + 1.0 - part;
            // A joint may have the opposite sign.
            common * ratio.signum() * ratio.abs().clamp(1.0 / MAX_RATIO, MAX_RATIO)
        };
        moments.iter().map(gain).collect()
    }
}

/// Prior standard deviation of a parameter of the payload: mass, kg, times a power of its size, m.
fn payload_scale(parameter: usize) -> f64 {
    PAYLOAD_KG * PAYLOAD_M.powi([0, 1, 1, 1, 2, 2, 2, 2, 2, 2][parameter])
}
