//! How a log is to be read: unit of its angles, order of its joints, sign of its torques, with or without gravity.
//! Gravity decides, since it is the only torque that is known beforehand.
//!
//! The arm at rest measures `s·τ = a·τ_gravity(q) + bias`. For every touch, the mean over its start at rest is taken.
//! The residual of a convention is the median of |s·τ − a·τ_gravity(q)| over the touches, so that a touch that begins
//! in contact has no effect. The residuals of conventions differ by tens of N·m and a bias is below 1 N·m, so the
//! smallest one is clear, unless the axes of the joints are vertical and gravity does not load them.
//!
//! If no touch begins at rest, single frames are used, which may have contacts. The residual is then not reliable, but
//! contacts do not follow gravity, so the slope of the torques on gravity decides.

use palpate::{ExternalTorqueConfig, Gravity, MIN_TARE_FRAMES, Payload, Robot, Sample, TorqueSign};
use palpate_io::log::AngleUnit;
use serde::Serialize;

use crate::conventions::{BETTER, MIN_GRAVITY, NEAR_SLOPE, residual};
use crate::touches::RecordedTouch;

/// Largest residual that is still good, as a part of gravity.
const GOOD_PART: f64 = 0.25;
/// Largest good residual of each joint, N·m, whatever gravity is: the bias of usual sensors.
const GOOD_BIAS: f64 = 0.4;
/// Another order of joints must have a residual below this ratio to that of the robot's order; it is strict, since
/// there are many orders.
const FAR_BETTER: f64 = 0.25;
/// Approximate number of single frames that are used if no touch begins at rest.
const FRAMES: usize = 200;

/// Samples at rest, or any samples if there are none.
#[derive(Debug, Clone)]
pub(super) struct Rests {
    pub all: Vec<Sample>,
    /// Whether the arm stands still in them.
    pub still: bool,
}

/// How well a convention explains the log.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ConventionFit {
    /// Sign of the torques.
    pub torque_sign: TorqueSign,
    /// Whether they contain gravity.
    pub gravity: Gravity,
    /// Median torque that gravity does not explain under this convention, N·m over all joints.
    #[serde(rename = "left_over")]
    pub residual: f64,
    /// Slope of the measured torques, in that sign, on those of gravity.
    pub slope: f64,
}

/// How well each convention explains the log, for one order of the joints.
#[derive(Debug, Clone, Serialize)]
pub struct ConventionFits {
    /// The convention of the settings.
    pub set: ConventionFit,
    /// The one with the smallest residual.
    pub best: ConventionFit,
    /// Torque of gravity at rest, N·m over all joints.
    pub gravity_torque: f64,
    /// Whether there are samples at rest; if not, the figures are of any frames.
    pub at_rest: bool,
    /// Whether the sign of `best` was found from the work of torques without gravity, and is not the one of the
    /// settings.
    pub by_work: bool,
    #[serde(skip)]
    n_joints: usize,
}

/// How a log should be read.
#[derive(Debug, Serialize)]
pub struct LogInterpretation {
    /// Unit in which the log seems to be.
    pub angle_unit: AngleUnit,
    /// Order of the joints that the log seems to have, if it is not the robot's: index in the log of each joint of the
    /// robot.
    pub order: Option<Vec<usize>>,
    /// Sign of the torques, as the log should be read.
    pub torque_sign: TorqueSign,
    /// Whether they contain gravity, as the log should be read.
    pub gravity: Gravity,
    /// Residual at rest under this convention, as a share of gravity; `None` if gravity is too small.
    pub unexplained_share: Option<f64>,
    /// A payload at the last link that would explain what gravity does not.
    pub payload: Option<Payload>,
    /// How well the conventions explain the log.
    pub fits: ConventionFits,
}

impl ConventionFit {
    /// Distance of the slope from that under the convention: 1 with gravity, 0 without.
    fn off_slope(&self) -> f64 {
        let expected = if self.gravity == Gravity::Included { 1.0 } else { 0.0 };
        (self.slope - expected).abs()
    }
}

impl ConventionFits {
    /// Whether gravity is large enough to compare conventions.
    pub fn has_enough_gravity(&self) -> bool {
        self.gravity_torque >= MIN_GRAVITY
    }

    /// Whether even the best convention has too large a residual.
    pub(super) fn misfit(&self) -> bool {
        let usual = GOOD_BIAS * (self.n_joints as f64).sqrt();
        let most = usual.max(GOOD_PART * self.gravity_torque);
        self.at_rest && self.has_enough_gravity() && self.best.residual > most
    }

    /// Takes the sign found from work, if the torques contain no gravity or gravity is too small to decide.
    pub(super) fn with_sign_by_work(mut self, sign: Option<TorqueSign>) -> Self {
        let both = [self.set, self.best];
        let without_gravity = both.iter().all(|fit| fit.gravity == Gravity::Removed);
        let decides = without_gravity || !self.has_enough_gravity();
        if let Some(torque_sign) = sign.filter(|sign| decides && *sign != self.set.torque_sign) {
            self.best = ConventionFit { torque_sign, ..self.set };
            self.by_work = true;
        }
        self
    }

    /// Whether another convention than that of the settings is right.
    pub(super) fn contradict(&self) -> bool {
        let other =
            (self.best.torque_sign, self.best.gravity) != (self.set.torque_sign, self.set.gravity);
        let better = if self.at_rest {
            self.best.residual < BETTER * self.set.residual
        } else {
            self.best.off_slope() < NEAR_SLOPE
        };
        self.by_work || self.has_enough_gravity() && !self.misfit() && other && better
    }

    /// The convention that the log should be read under.
    pub fn accepted(&self) -> ConventionFit {
        if self.contradict() { self.best } else { self.set }
    }
}

/// The means over the starts at rest, or some frames if there are none.
pub(super) fn rests(touches: &[RecordedTouch], still_rad: f64) -> Rests {
    let starts: Vec<Sample> = (touches.iter())
        .filter_map(|touch| {
            let rows = &touch.samples[..touch.still_frames(still_rad)];
            let mean = |of: fn(&Sample) -> &[f64]| super::mean(rows, of);
            let still = rows.len() >= MIN_TARE_FRAMES as usize;
            still.then(|| Sample::new(None, mean(|row| &row.q), mean(|row| &row.tau)))
        })
        .collect();
    if !starts.is_empty() {
        return Rests { all: starts, still: true };
    }
    let frames: usize = touches.iter().map(RecordedTouch::frames).sum();
    let all = touches.iter().flat_map(|touch| &touch.samples);
    let some = all.step_by(frames.div_ceil(FRAMES).max(1));
    Rests { all: some.cloned().collect(), still: false }
}

/// How well the conventions explain what was measured at rest.
pub(super) fn fits(
    robot: &Robot,
    rests: &Rests,
    order: &[usize],
    set: &ExternalTorqueConfig,
) -> ConventionFits {
    let pick = |row: &[f64]| order.iter().map(|&place| row[place]).collect::<Vec<f64>>();
    // Torque of gravity and measured torque at each moment, n_joints, N·m.
    let torques = |rest: &Sample| {
        let poses = robot.forward(&pick(&rest.q)).ok()?;
        Some((robot.gravity_torque(&poses).as_slice().to_vec(), pick(&rest.tau)))
    };
    let torques: Vec<(Vec<f64>, Vec<f64>)> = rests.all.iter().filter_map(torques).collect();
    let square: f64 = torques.iter().map(|(gravity, _)| dot(gravity, gravity)).sum();
    let cross: f64 = torques.iter().map(|(gravity, tau)| dot(gravity, tau)).sum();
    let fit = |torque_sign: TorqueSign, gravity: Gravity| {
        let sign = super::sign(torque_sign);
        let part = if gravity == Gravity::Included { 1.0 } else { 0.0 };
        let slope = if square > 0.0 { sign * cross / square } else { 0.0 };
        ConventionFit {
            torque_sign,
            gravity,
            residual: residual(&torques, sign, part).unwrap_or(0.0),
            slope,
        }
    };
    // Without gravity the sign cannot be determined: it is left as set.
    let all = [
        fit(set.torque_sign, set.gravity),
        fit(TorqueSign::Plus, Gravity::Included),
        fit(TorqueSign::Minus, Gravity::Included),
        fit(set.torque_sign, Gravity::Removed),
    ];
    let off = |fit: &ConventionFit| if rests.still { fit.residual } else { fit.off_slope() };
    let best = all.into_iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(all[0]);
    let (gravity_torque, n_joints) = (residual(&torques, 0.0, 1.0).unwrap_or(0.0), order.len());
    ConventionFits {
        set: all[0],
        best,
        gravity_torque,
        at_rest: rests.still,
        by_work: false,
        n_joints,
    }
}

/// Joints whose torques at rest have the sign of gravity's, and those with the opposite sign; `None` if all have the
/// same sign, or negating the smaller group does not fit gravity far better.
pub(super) fn by_sign(
    robot: &Robot,
    rests: &Rests,
    set: &ExternalTorqueConfig,
    straight: &ConventionFits,
) -> Option<[Vec<usize>; 2]> {
    if !rests.still || !straight.has_enough_gravity() {
        return None;
    }
    let torques: Vec<(Vec<f64>, &Vec<f64>)> = (rests.all.iter())
        .filter_map(|rest| {
            let poses = robot.forward(&rest.q).ok()?;
            Some((robot.gravity_torque(&poses).as_slice().to_vec(), &rest.tau))
        })
        .collect();
    // Sign of the slope of a joint's torques on gravity: 0 if gravity hardly loads it, or does not explain them.
    let sign = |joint: usize| {
        let sum = |of: fn(f64, f64) -> f64| -> f64 {
            torques.iter().map(|(gravity, tau)| of(gravity[joint], tau[joint])).sum()
        };
        let (square, cross) = (sum(|g, _| g * g), sum(|g, tau| g * tau));
        let loaded = square >= torques.len() as f64 * MIN_GRAVITY * MIN_GRAVITY;
        let follows = (cross.abs() / square - 1.0).abs() < NEAR_SLOPE;
        if loaded && follows { cross.signum() } else { 0.0 }
    };
    let signs: Vec<f64> = (0..robot.n_joints()).map(sign).collect();
    let by_sign =
        [1.0, -1.0].map(|sign| (0..signs.len()).filter(|&joint| signs[joint] == sign).collect());
    let [plus, minus]: &[Vec<usize>; 2] = &by_sign;
    let odd = if plus.len() < minus.len() { plus } else { minus };
    let mut turned = rests.clone();
    turned.all.iter_mut().for_each(|rest| odd.iter().for_each(|&joint| rest.tau[joint] *= -1.0));
    let order: Vec<usize> = (0..robot.n_joints()).collect();
    let better = fits(robot, &turned, &order, set);
    let explains = better.best.gravity == Gravity::Included
        && !better.misfit()
        && better.best.residual < FAR_BETTER * straight.best.residual;
    (!odd.is_empty() && explains).then_some(by_sign)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Another order of the joints that explains the log far better than the robot's, if there is one.
pub(super) fn other_order(
    robot: &Robot,
    rests: &Rests,
    set: &ExternalTorqueConfig,
    straight: &ConventionFits,
) -> Option<(Vec<usize>, ConventionFits)> {
    if !straight.misfit() {
        return None;
    }
    let candidates = orders(robot.n_joints()).map(|order| {
        let fits = fits(robot, rests, &order, set);
        (order, fits)
    });
    let far_better = |(_, fits): &(Vec<usize>, ConventionFits)| {
        fits.has_enough_gravity()
            && !fits.misfit()
            && fits.best.residual < FAR_BETTER * straight.best.residual
    };
    candidates
        .filter(far_better)
        .min_by(|(_, a), (_, b)| a.best.residual.total_cmp(&b.best.residual))
}

/// Orders that occur in practice: reversed, rotated (a base or gripper first), two joints swapped.
fn orders(n: usize) -> impl Iterator<Item = Vec<usize>> {
    let reversed = std::iter::once((0..n).rev().collect());
    let turned = (1..n).map(move |by| (0..n).map(|joint| (joint + by) % n).collect());
    let pairs = (0..n).flat_map(move |a| (a + 1..n).map(move |b| (a, b)));
    let swapped = pairs.map(move |(a, b)| {
        let mut order: Vec<usize> = (0..n).collect();
        order.swap(a, b);
        order
    });
    reversed.chain(turned).chain(swapped)
}
