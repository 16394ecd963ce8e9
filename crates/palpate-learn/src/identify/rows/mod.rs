//! Samples as rows of the regression: for each joint, the motor torque and the regressors that explain it.
//!
//! A row of joint j contains, in this order,
//!
//! ```text
//! [ Y_j (10 · n_bodies) | −dτ/dt | coulomb asymmetry breakaway viscous rotor |
//!   1 cos q sin q | slopes | offset, drift by touch | τ ]
//! ```
//!
//! The slopes are the changes of friction with the presliding distance and with the Stribeck speed. Both are found by
//! search, so the coefficients of the slopes are small; they are there to add the uncertainty of both to the standard
//! deviations.
//!
//! The posterior needs only the Gram matrix of the rows, by joint and by fold. The search for friction at reversals
//! (`reversal`) needs the rows themselves.

mod reversal;

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use palpate::unstable::{
    FrictionState, JointMotion, LocalPolynomial, N_INERTIAL_PARAMETERS, TouchMotion, Window,
};
use palpate::{JointFriction, Robot, Sample, TorqueSign};
use rayon::prelude::*;

pub(super) use reversal::FrictionReversal;

use super::IdentifyError;
use super::contact_samples::Touched;
use super::posterior::Posterior;

/// About the most rows of each joint; with more samples, a row is the mean of several.
const MAX_ROWS: usize = 4_000;
/// Folds of held-out motion.
pub(super) const FOLDS: usize = 4;
/// Most offsets and drifts by touch; all further touches share the last ones.
const MAX_OFFSETS: usize = 12;
/// Sampling rate of later logs, relative to that of these logs, at which the time window must still give speeds.
const SLOWER: f64 = 0.75;
/// Largest uncertainty of the friction state ([`FrictionState::unknown`]) at which a row of the joint is used.
const MAX_UNKNOWN: f64 = 0.1;
/// Coefficients of friction and drive: coulomb, asymmetry, breakaway, viscous, rotor.
pub(super) const FRICTION: usize = 5;
/// Coefficients of the bias: constant, cosine, sine.
pub(super) const BIAS: usize = 3;
/// Slopes of friction: with the presliding distance, with the Stribeck speed.
pub(super) const SLOPES: usize = 2;
/// Relative step of the finite differences that give the slopes.
const SLOPE_STEP: f64 = 0.25;

/// Settings with which rows are computed.
#[derive(Debug, Clone)]
pub(super) struct RegressionSettings {
    pub(super) window_s: f64,
    pub(super) delay_s: f64,
    /// By joint.
    pub(super) turning: Vec<FrictionReversal>,
    /// Samples that are left out of the regression.
    pub(super) touched: Touched,
}

/// One moment of a touch: the rows of all joints.
struct Row {
    fold: usize,
    touch: usize,
    samples: Range<usize>,
    /// Whether the row is left out.
    is_touched: bool,
    /// Time of the motion, s: that of the torque minus the delay.
    time_s: f64,
    /// Time within the touch, from −0.5 (start) to 0.5 (end).
    part: f64,
    motion: JointMotion,
    /// Y, n_joints × (10 · n_bodies).
    regressor: DMatrix<f64>,
    /// Friction states with a presliding distance that is longer by [`SLOPE_STEP`].
    longer: Vec<f64>,
    /// Logged torques with the sign of motor torques, n_joints, and their time derivatives, per second.
    torque: Vec<f64>,
    change: Vec<f64>,
}

impl Row {
    fn knows_friction(&self, j: usize) -> bool {
        self.motion.unknown[j] <= MAX_UNKNOWN
    }

    /// Whether any sample of this row is in `touched`.
    fn is_in(&self, touched: &Touched) -> bool {
        touched[self.touch][self.samples.clone()].contains(&true)
    }
}

/// All rows.
pub(super) struct Rows {
    rows: Vec<Row>,
    /// Positions and friction states of each touch.
    motions: Vec<TouchMotion>,
    n_joints: usize,
    pub(super) n_parameters: usize,
    pub(super) offsets: usize,
    /// Whether speeds can be determined.
    pub(super) timed: bool,
    turning: Vec<FrictionReversal>,
    /// By fold and joint.
    sums: Vec<Vec<Sum>>,
}

/// Number and Gram matrix of rows of a joint.
#[derive(Debug, Clone)]
pub(super) struct Sum {
    pub(super) rows: f64,
    pub(super) gram: DMatrix<f64>,
}

/// Computes rows from touches.
struct Reading<'a> {
    robot: &'a Robot,
    settings: &'a RegressionSettings,
    sign: TorqueSign,
    timed: bool,
    /// Samples that are averaged in a row.
    stride: usize,
    touches: usize,
}

impl Reading<'_> {
    /// The rows of a touch.
    fn read(
        &self,
        touch: usize,
        samples: &[Sample],
        states: &TouchMotion,
    ) -> Result<Vec<Row>, IdentifyError> {
        let Self { robot, settings, timed, .. } = *self;
        let n = robot.n_joints();
        let times = states.times_s();
        let motor = if self.sign == TorqueSign::Minus { 1.0 } else { -1.0 };
        let torques =
            samples.iter().map(|sample| sample.tau.iter().map(|tau| motor * tau).collect());
        let torques: Vec<Vec<f64>> = torques.collect();
        let change = LocalPolynomial::new(times, &torques, settings.window_s, Window::Centred);
        let longer: Vec<Vec<FrictionState>> = (settings.turning.iter().enumerate())
            .map(|(j, own)| states.friction_of(j, (1.0 + SLOPE_STEP) * own.presliding))
            .collect();
        let (first, last) = (times[0], times[times.len() - 1]);
        let row = |start: usize| -> Result<Row, IdentifyError> {
            let chunk = start..(start + self.stride).min(samples.len());
            let mean =
                |of: &dyn Fn(usize) -> f64| chunk.clone().map(of).sum::<f64>() / chunk.len() as f64;
            let time = mean(&|k| times[k]);
            let time_s = time - settings.delay_s;
            let motion = states.at(time_s, settings.window_s, Window::Centred);
            let poses = robot.forward(&motion.q).map_err(palpate::TrackerError::from)?;
            let regressor = robot.regressor(&poses, &motion.speed, &motion.acceleration);
            let torque = (0..n).map(|j| mean(&|k| torques[k][j])).collect();
            let change = if timed { change.at(time).first } else { vec![0.0; n] };
            let part = if last > first { (time - first) / (last - first) - 0.5 } else { 0.0 };
            let fold = fold(self.touches, touch, part);
            let longer =
                longer.iter().zip(&settings.turning).enumerate().map(|(j, (own, turning))| {
                    let presliding = (1.0 + SLOPE_STEP) * turning.presliding;
                    states.friction_at(time_s, j, (own, presliding)).middle()
                });
            let longer = longer.collect();
            Ok(Row {
                is_touched: false,
                samples: chunk,
                fold,
                touch,
                time_s,
                part,
                motion,
                regressor,
                longer,
                torque,
                change,
            })
        };
        let starts: Vec<usize> = (0..samples.len()).step_by(self.stride).collect();
        starts.into_par_iter().map(row).collect()
    }
}

impl Rows {
    pub(super) fn of(
        robot: &Robot,
        touches: &[&[Sample]],
        sign: TorqueSign,
        settings: &RegressionSettings,
    ) -> Result<Self, IdentifyError> {
        let presliding: Vec<f64> = settings.turning.iter().map(|own| own.presliding).collect();
        let motions: Vec<TouchMotion> = touches
            .iter()
            .map(|samples| TouchMotion::of(robot, samples, presliding.clone()))
            .collect();
        let timed = motions.iter().all(|motion| motion.is_timed(settings.window_s));
        let samples: usize = touches.iter().map(|touch| touch.len()).sum();
        let stride = samples.div_ceil(MAX_ROWS);

        let how = Reading { robot, settings, sign, timed, stride, touches: touches.len() };
        let mut rows = Vec::new();
        for (index, (samples, motion)) in touches.iter().zip(&motions).enumerate() {
            rows.extend(how.read(index, samples, motion)?);
        }
        let mut all = Self {
            rows,
            motions,
            n_joints: robot.n_joints(),
            n_parameters: N_INERTIAL_PARAMETERS * robot.bodies().len(),
            offsets: touches.len().min(MAX_OFFSETS),
            timed,
            turning: settings.turning.clone(),
            sums: Vec::new(),
        };
        all.leave_out(&settings.touched);
        Ok(all)
    }

    /// Leaves out the rows that contain these samples, and uses all others.
    pub(super) fn leave_out(&mut self, touched: &Touched) {
        for row in &mut self.rows {
            row.is_touched = row.is_in(touched);
        }
        let (all, joints) = (&*self, 0..self.n_joints);
        let of_fold =
            |fold| joints.clone().into_par_iter().map(|j| all.sum(fold, j)).collect::<Vec<Sum>>();
        self.sums = (0..FOLDS).into_par_iter().map(of_fold).collect();
    }

    /// Mean time between samples, s; 0 without a clock.
    pub(super) fn interval_s(&self) -> f64 {
        let ends = |times: &[f64]| times.last().zip(times.first()).map_or(0.0, |(b, a)| b - a);
        let span: f64 = self.motions.iter().map(|motion| ends(motion.times_s())).sum();
        let steps: usize = self.motions.iter().map(|motion| motion.times_s().len() - 1).sum();
        if self.timed && steps > 0 { span / steps as f64 } else { 0.0 }
    }

    /// Whether this half window, s, gives speeds, also at [`SLOWER`] times the sampling rate.
    pub(super) fn is_timed(&self, window_s: f64) -> bool {
        self.motions.iter().all(|motion| motion.is_timed(SLOWER * window_s))
    }

    /// Length of a row, including τ.
    pub(super) fn width(&self) -> usize {
        self.n_parameters + 1 + FRICTION + BIAS + SLOPES + 2 * self.offsets + 1
    }

    pub(super) fn n_joints(&self) -> usize {
        self.n_joints
    }

    fn numbers(&self, row: &Row, j: usize) -> DVector<f64> {
        let mut numbers = DVector::zeros(self.width());
        let own = &row.motion;
        for (to, from) in numbers.iter_mut().zip(row.regressor.row(j).iter()) {
            *to = *from;
        }
        let at = self.n_parameters;
        numbers[at] = -row.change[j];
        if self.timed {
            let factors =
                JointFriction::factors(own.friction[j], own.speed[j], self.turning[j].stribeck);
            factors.iter().enumerate().for_each(|(k, factor)| numbers[at + 1 + k] = *factor);
            numbers[at + FRICTION] = own.acceleration[j];
        } else {
            numbers[at + 1] = own.friction[j];
        }
        let at = at + 1 + FRICTION;
        numbers[at] = 1.0;
        numbers[at + 1] = own.q[j].cos();
        numbers[at + 2] = own.q[j].sin();
        if self.timed {
            let (z, longer, speed) = (own.friction[j], row.longer[j], own.speed[j]);
            let stribeck = self.turning[j].stribeck;
            let falls = |stribeck: f64| z * (-speed.abs() / stribeck).exp();
            numbers[at + BIAS] = longer - z;
            numbers[at + BIAS + 1] = falls((1.0 + SLOPE_STEP) * stribeck) - falls(stribeck);
        }
        let offset = at + BIAS + SLOPES + 2 * row.touch.min(MAX_OFFSETS - 1);
        numbers[offset] = 1.0;
        numbers[offset + 1] = row.part;
        numbers[self.width() - 1] = row.torque[j];
        numbers
    }

    /// The rows that are used for a joint, of those not left out: those in which its friction state is known, or all
    /// if it is known in none; no rows if its torque is not measured.
    fn of_joint(&self, j: usize) -> impl Iterator<Item = &Row> {
        let is_known = move |row: &Row| row.knows_friction(j);
        let any = self.rows.iter().any(is_known);
        let is_measured = self.is_measured(j);
        let serves = move |row: &&Row| !row.is_touched && is_measured && (!any || is_known(row));
        self.rows.iter().filter(serves)
    }

    /// Whether the torque of a joint ever varies.
    fn is_measured(&self, j: usize) -> bool {
        self.rows.iter().any(|row| row.torque[j] != self.rows[0].torque[j])
    }

    fn sum(&self, fold: usize, j: usize) -> Sum {
        let rows = self.of_joint(j).filter(|row| row.fold == fold);
        let own: Vec<DVector<f64>> = rows.map(|row| self.numbers(row, j)).collect();
        let width = self.width();
        if own.is_empty() {
            return Sum { rows: 0.0, gram: DMatrix::zeros(width, width) };
        }
        let matrix = DMatrix::from_columns(&own);
        Sum { rows: own.len() as f64, gram: &matrix * matrix.transpose() }
    }

    /// All rows of each joint.
    pub(super) fn all(&self) -> Vec<Sum> {
        self.without(usize::MAX)
    }

    /// All rows of each joint but those of a fold.
    pub(super) fn without(&self, fold: usize) -> Vec<Sum> {
        let width = self.width();
        (0..self.n_joints)
            .map(|j| {
                let mut sum = Sum { rows: 0.0, gram: DMatrix::zeros(width, width) };
                for (index, sums) in self.sums.iter().enumerate() {
                    if index != fold {
                        sum.rows += sums[j].rows;
                        sum.gram += &sums[j].gram;
                    }
                }
                sum
            })
            .collect()
    }

    /// Autocorrelation time of the residuals, in rows, by joint: `1 + 2 Σ ρ_k`, summed until a correlation ρ_k is below
    /// 0.05 (Sokal 1997). n rows count as n divided by it.
    pub(super) fn correlated(&self, posterior: &Posterior) -> Vec<f64> {
        (0..self.n_joints)
            .map(|j| {
                let coefficients = posterior.row_coefficients(j);
                let own: Vec<(usize, f64)> = (self.of_joint(j))
                    .map(|row| (row.touch, self.numbers(row, j).dot(&coefficients)))
                    .collect();
                let product = |lag: usize| -> f64 {
                    let pairs = own.iter().zip(&own[lag.min(own.len())..]);
                    pairs.filter(|(a, b)| a.0 == b.0).map(|(a, b)| a.1 * b.1).sum()
                };
                let power = product(0);
                let mut factor = 1.0;
                for lag in 1..own.len() / 4 {
                    let correlation = if power > 0.0 { product(lag) / power } else { 0.0 };
                    if correlation < 0.05 {
                        break;
                    }
                    factor += 2.0 * correlation;
                }
                factor
            })
            .collect()
    }

    /// Number of rows, including those that are left out.
    pub(super) fn len(&self) -> usize {
        self.rows.len()
    }

    /// The touch of a row, and the row's samples in it.
    pub(super) fn samples(&self, row: usize) -> (usize, Range<usize>) {
        (self.rows[row].touch, self.rows[row].samples.clone())
    }

    /// Residual of a joint in each row, in logged units; `None` where its friction state or its torque is not known.
    fn residuals(&self, posterior: &Posterior, j: usize) -> Vec<Option<f64>> {
        let coefficients = posterior.row_coefficients(j);
        let is_measured = self.is_measured(j);
        let left = |row: &Row| {
            let is_known = is_measured && row.knows_friction(j);
            is_known.then(|| self.numbers(row, j).dot(&coefficients))
        };
        self.rows.iter().map(left).collect()
    }

    /// Sum of squared residuals of a joint, each fold under the model that did not learn it; samples in `but` are not
    /// counted.
    pub(super) fn held_out(&self, models: &[Option<Posterior>], j: usize, but: &Touched) -> f64 {
        let of_fold = |(fold, model): (usize, &Option<Posterior>)| {
            let Some(model) = model else { return 0.0 };
            let serves = |row: &Row| row.fold == fold && !row.is_in(but);
            let left = self.residuals(model, j);
            let left = self.rows.iter().zip(left).filter(|(row, _)| serves(row));
            left.filter_map(|(_, left)| left).map(|left| left * left).sum()
        };
        models.iter().enumerate().map(of_fold).sum()
    }

    /// A mask of no samples.
    pub(super) fn no_samples(&self) -> Touched {
        self.motions.iter().map(|motion| vec![false; motion.times_s().len()]).collect()
    }

    /// Residuals of a joint, averaged over windows of `2 · half_s` around each row.
    pub(super) fn mean_residuals(
        &self,
        posterior: &Posterior,
        j: usize,
        half_s: f64,
    ) -> Vec<Option<f64>> {
        let left = self.residuals(posterior, j);
        let mut means = Vec::with_capacity(left.len());
        for touch in self.rows.chunk_by(|a, b| a.touch == b.touch) {
            let left = &left[means.len()..means.len() + touch.len()];
            let times = |k: usize| touch[k].time_s;
            let (mut from, mut to, mut sum, mut count) = (0, 0, 0.0, 0_u32);
            for (k, own) in left.iter().enumerate() {
                while to < touch.len() && times(to) <= times(k) + half_s {
                    sum += left[to].unwrap_or(0.0);
                    count += u32::from(left[to].is_some());
                    to += 1;
                }
                while times(from) < times(k) - half_s {
                    sum -= left[from].unwrap_or(0.0);
                    count -= u32::from(left[from].is_some());
                    from += 1;
                }
                means.push(own.map(|_| sum / f64::from(count)));
            }
        }
        means
    }
}

/// The fold of a moment (`part` is the time in the touch, −0.5 to 0.5): folds are whole touches, or quarters of each
/// touch if there are fewer than three.
pub(super) fn fold(touches: usize, touch: usize, part: f64) -> usize {
    if touches >= 3 {
        touch % FOLDS
    } else {
        (((part + 0.5) * FOLDS as f64) as usize).min(FOLDS - 1)
    }
}
