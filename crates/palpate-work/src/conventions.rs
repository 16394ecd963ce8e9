//! The convention of logged torques, found from the data: their sign, and whether they contain gravity.
//!
//! Two facts hold for any arm. First, `s·τ − a·τ_gravity(q)` with s = ±1 and a = 0 or 1 is small under the right
//! convention. Second, friction and yielding contacts never give the arm more energy than they have taken: from a
//! contact-free start on, `∫ τ_ext·dq` is never positive. So torques without gravity that do positive work on the arm
//! have the sign of motor torques.
//!
//! The whole motion is used, not only its start: gravity exerts no torque on an upright arm.

use std::fmt;

use palpate::{ExternalTorqueConfig, Gravity, MIN_TARE_FRAMES, Robot, Sample, TorqueSign};

use crate::inspect::{mean, number, word};
use crate::quantile::median;

/// Approximate number of frames for which gravity is computed.
const FRAMES: usize = 2_000;
/// Least torque of gravity, N·m, for which conventions are compared; with less, gravity hardly matters.
pub(crate) const MIN_GRAVITY: f64 = 1.0;
/// Torques below this, N·m, are noise of the sensors.
const MIN_TORQUE: f64 = 0.05;
/// A convention is accepted if its residual is at most this part of gravity and less than this part of any other's,
pub(crate) const BETTER: f64 = 0.5;
/// or if the slope of the torques on gravity differs by less than this from the slope that it implies.
pub(crate) const NEAR_SLOPE: f64 = 0.3;
/// Torques are proportional to gravity if it explains more than this share of their sum of squares, and the slope is
/// larger than a small error of the robot's masses causes.
const EXPLAINED: f64 = 0.7;
const MIN_SLOPE: f64 = 0.05;
/// Largest slope of motor currents on gravity: torque constants times gear ratios are above 2 N·m/A.
const MAX_CURRENT_SLOPE: f64 = 0.5;
/// Slopes on gravity of an arm that carries more than its file says; larger ones are due to another unit.
const LADEN_SLOPES: std::ops::Range<f64> = 1.3..5.0;
/// Slopes on gravity of torques in mN·m; the upper end is for a payload as heavy as the arm.
const IN_THOUSANDTHS: std::ops::Range<f64> = 800.0..2000.0;
/// Least work from which the sign is concluded, J.
const MIN_WORK_J: f64 = 0.005;
/// Largest ratio of the work in one direction to the larger work in the other from which the sign is concluded.
const MAX_BACK: f64 = 0.3;
/// Fewest frames at rest at the start that give a tare.
const MIN_TARE: usize = MIN_TARE_FRAMES as usize;

/// What is computed from the torques of a log to decide their convention.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ConventionEvidence {
    /// Median over frames of the norm of the logged torque, and of that of gravity, N·m.
    torque: f64,
    gravity: f64,
    /// The largest torque of a joint, N·m.
    largest: f64,
    /// Median over frames of |s·τ − τ_gravity| for s = 1 and s = −1, N·m over all joints.
    after_gravity: [f64; 2],
    /// Slope of the torques on gravity, and the share of their sum of squares that it explains.
    slope: f64,
    explained: f64,
    /// Slope and explained share for the first samples of the touches.
    slope_at_start: f64,
    explained_at_start: f64,
    /// Joints whose torques follow gravity with the sign plus, and those with the sign minus, a bit for each joint.
    joints_by_sign: [u64; 2],
    work: Work,
}

/// Slope of torques on gravity, and the share of their sum of squares that it explains; `torques` are pairs of
/// gravity's torques and logged ones, N·m.
fn slope(torques: &[(Vec<f64>, Vec<f64>)]) -> (f64, f64) {
    let sum = |of: fn(&f64, &f64) -> f64| -> f64 {
        torques.iter().flat_map(|(g, tau)| g.iter().zip(tau)).map(|(g, tau)| of(g, tau)).sum()
    };
    let (square, cross, of_torques) =
        (sum(|g, _| g * g), sum(|g, tau| g * tau), sum(|_, tau| tau * tau));
    if square > 0.0 && of_torques > 0.0 {
        (cross / square, cross * cross / square / of_torques)
    } else {
        (0.0, 0.0)
    }
}

/// The joints whose torques are about those of gravity, and those whose torques are about minus those, a bit for each.
fn joints_by_sign(torques: &[(Vec<f64>, Vec<f64>)]) -> [u64; 2] {
    let joints = torques.first().map_or(0, |(gravity, _)| gravity.len());
    let mut bits = [0; 2];
    for joint in 0..joints.min(64) {
        let of_joint = |(g, tau): &(Vec<f64>, Vec<f64>)| (vec![g[joint]], vec![tau[joint]]);
        let of_joint: Vec<_> = torques.iter().map(of_joint).collect();
        let has_gravity = residual(&of_joint, 0.0, 1.0).is_some_and(|size| size >= MIN_GRAVITY);
        let (slope, explained) = slope(&of_joint);
        if has_gravity && explained > EXPLAINED && (slope.abs() - 1.0).abs() < NEAR_SLOPE {
            bits[usize::from(slope < 0.0)] |= 1 << joint;
        }
    }
    bits
}

/// Work that torques do on an arm, summed from the start of each touch, J.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Work {
    /// Largest value of the work during a touch, summed over touches.
    done: f64,
    /// Minus the lowest value of the work during a touch, summed over touches.
    taken: f64,
}

/// Why no convention could be chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Undecided {
    /// Two conventions fit about equally well.
    Ambiguous(ConventionEvidence),
    /// The torques contain no gravity, and their work does not show the sign.
    Sign(ConventionEvidence),
    /// No convention fits: another unit, another robot, a payload, contacts throughout.
    NoFit(ConventionEvidence),
}

/// The given part of the convention; the rest is to be found.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct KnownConvention {
    pub(crate) torque_sign: Option<TorqueSign>,
    pub(crate) gravity: Option<Gravity>,
}

impl KnownConvention {
    /// A convention that is given completely.
    pub(crate) fn of(set: &ExternalTorqueConfig) -> Self {
        Self { torque_sign: Some(set.torque_sign), gravity: Some(set.gravity) }
    }
}

/// A decided convention, and the evidence for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct TorqueConvention {
    pub(crate) torque_sign: TorqueSign,
    pub(crate) gravity: Gravity,
    evidence: ConventionEvidence,
}

impl TorqueConvention {
    /// Whether gravity is large enough to show the convention, and there are torques.
    pub(crate) fn is_by_gravity(&self) -> bool {
        self.evidence.shows_gravity() && !self.is_without_torque()
    }

    /// Whether only the work of the torques can show their sign.
    pub(crate) fn is_by_work(&self) -> bool {
        self.gravity == Gravity::Removed || !self.evidence.shows_gravity()
    }

    /// Whether all torques are near zero.
    pub(crate) fn is_without_torque(&self) -> bool {
        self.evidence.largest < MIN_TORQUE
    }
}

/// The median of |sign·τ − part·τ_gravity| over samples, N·m over all joints; `torques` are pairs of gravity's torques
/// and logged ones.
pub(crate) fn residual(torques: &[(Vec<f64>, Vec<f64>)], sign: f64, part: f64) -> Option<f64> {
    let norm = |(gravity, tau): &(Vec<f64>, Vec<f64>)| {
        let joints = tau.iter().zip(gravity);
        joints.map(|(tau, gravity)| (sign * tau - part * gravity).powi(2)).sum::<f64>().sqrt()
    };
    median(&torques.iter().map(norm).collect::<Vec<_>>())
}

impl ConventionEvidence {
    /// The evidence of some touches, joints in the robot's order; `None` without samples.
    pub(crate) fn of(robot: &Robot, touches: &[&[Sample]], still_rad: f64) -> Option<Self> {
        let samples: usize = touches.iter().map(|touch| touch.len()).sum();
        let every = samples.div_ceil(FRAMES).max(1);
        let some = touches.iter().copied().flatten().step_by(every);
        let with_gravity = |Sample { q, tau, .. }: &Sample| {
            let poses = robot.forward(q).ok()?;
            let finite = tau.iter().all(|tau| tau.is_finite());
            finite.then(|| (robot.gravity_torque(&poses).as_slice().to_vec(), tau.clone()))
        };
        let torques: Vec<(Vec<f64>, Vec<f64>)> = some.filter_map(with_gravity).collect();
        let residual_of = |sign, part| residual(&torques, sign, part);
        let starts = touches.iter().filter_map(|touch| touch.first());
        let starts: Vec<(Vec<f64>, Vec<f64>)> = starts.filter_map(with_gravity).collect();
        let ((slope, explained), (slope_at_start, explained_at_start)) =
            (slope(&torques), slope(&starts));
        let joints = torques.iter().flat_map(|(_, tau)| tau);
        Some(Self {
            largest: joints.fold(0.0, |largest, tau| tau.abs().max(largest)),
            torque: residual_of(1.0, 0.0)?,
            gravity: residual_of(0.0, 1.0)?,
            after_gravity: [residual_of(1.0, 1.0)?, residual_of(-1.0, 1.0)?],
            slope,
            explained,
            slope_at_start,
            explained_at_start,
            joints_by_sign: joints_by_sign(&torques),
            work: Work::of(robot, touches, still_rad),
        })
    }

    /// The joints of which gravity shows the sign plus, and those with minus, if there are both.
    pub(crate) fn negated_joints(&self) -> Option<[Vec<usize>; 2]> {
        let joints = self
            .joints_by_sign
            .map(|bits| (0..64).filter(|joint| bits >> joint & 1 == 1).collect());
        joints.iter().all(|joints: &Vec<usize>| !joints.is_empty()).then_some(joints)
    }

    /// The sign of torques without gravity, if their work shows it.
    pub(crate) fn sign_by_work(&self) -> Option<TorqueSign> {
        self.work.sign().filter(|_| self.largest >= MIN_TORQUE)
    }

    /// Whether the torques at the starts of touches are proportional to gravity, as motor currents are and contact
    /// torques are not, and follow it later as well.
    fn is_proportional(&self) -> bool {
        self.explained_at_start > EXPLAINED
            && self.slope_at_start.abs() > MIN_SLOPE
            && self.slope.abs() > MIN_SLOPE
            && self.slope * self.slope_at_start > 0.0
    }

    /// Whether gravity is large enough to show whether torques contain it.
    pub(crate) fn shows_gravity(&self) -> bool {
        self.gravity >= MIN_GRAVITY
    }

    /// The slope of the torques on those of gravity.
    pub(crate) fn slope(&self) -> f64 {
        self.slope
    }

    /// The sign under which the torques grow with those of gravity.
    pub(crate) fn sign_of_slope(&self) -> TorqueSign {
        if self.slope > 0.0 { TorqueSign::Plus } else { TorqueSign::Minus }
    }

    /// Whether the torques follow gravity as motor currents do, which are much smaller.
    pub(crate) fn is_like_currents(&self) -> bool {
        self.is_proportional()
            && self.slope.abs() < MAX_CURRENT_SLOPE
            && self.negated_joints().is_none()
    }

    /// Whether the torques are proportional to gravity and larger, as with a payload that is not given or with too
    /// small masses in the robot's file. They contain gravity then, and the slope shows their sign.
    fn is_laden(&self) -> bool {
        self.explained > EXPLAINED && LADEN_SLOPES.contains(&self.slope.abs())
    }

    /// Decides the convention, of which a part may be given.
    pub(crate) fn decide(self, given: KnownConvention) -> Result<TorqueConvention, Undecided> {
        let KnownConvention { torque_sign: sign, gravity } = given;
        let found =
            |torque_sign, gravity| TorqueConvention { torque_sign, gravity, evidence: self };
        if let (Some(torque_sign), Some(gravity)) = (sign, gravity) {
            return Ok(found(torque_sign, gravity));
        }
        if self.largest < MIN_TORQUE {
            let has_gravity = self.gravity >= MIN_GRAVITY;
            let held = if has_gravity { Gravity::Removed } else { Gravity::Included };
            return Ok(found(sign.unwrap_or_default(), gravity.unwrap_or(held)));
        }
        let removed = |gravity| {
            let sign = sign.or(self.sign_by_work()).ok_or(Undecided::Sign(self))?;
            Ok(found(sign, gravity))
        };
        if self.gravity < MIN_GRAVITY {
            return removed(gravity.unwrap_or_default());
        }
        if gravity == Some(Gravity::Removed) {
            return removed(Gravity::Removed);
        }
        let [plus, minus] = self.after_gravity;
        let mut candidates = vec![
            (plus, 1.0, TorqueSign::Plus, Gravity::Included),
            (minus, -1.0, TorqueSign::Minus, Gravity::Included),
        ];
        candidates.retain(|(_, _, of, _)| sign.is_none_or(|sign| sign == *of));
        if gravity.is_none() {
            candidates.push((self.torque, 0.0, TorqueSign::Plus, Gravity::Removed));
        }
        candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (least, slope, torque_sign, held) = candidates[0];
        let near = (self.slope - slope).abs() < NEAR_SLOPE;
        let clear = candidates.get(1).is_none_or(|other| least < BETTER * other.0);
        match held {
            _ if self.is_laden() && gravity != Some(Gravity::Removed) => {
                let own = self.sign_of_slope();
                match sign {
                    Some(sign) if sign != own => Err(Undecided::NoFit(self)),
                    _ => Ok(found(own, Gravity::Included)),
                }
            }
            _ if !near && least > BETTER * self.gravity => Err(Undecided::NoFit(self)),
            _ if !near && !clear => Err(Undecided::Ambiguous(self)),
            Gravity::Included => Ok(found(torque_sign, held)),
            Gravity::Removed if self.is_proportional() || self.negated_joints().is_some() => {
                Err(Undecided::NoFit(self))
            }
            Gravity::Removed => removed(held),
        }
    }
}

impl fmt::Display for TorqueConvention {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ConventionEvidence { torque, gravity, after_gravity, slope, work, .. } = self.evidence;
        let sign = word(self.torque_sign);
        let [torque, gravity] = [torque, gravity].map(number);
        if self.is_without_torque() {
            return write!(f, "the torques are near zero throughout: were they recorded?");
        }
        if self.gravity == Gravity::Included && self.evidence.shows_gravity() {
            let residual =
                number(after_gravity[usize::from(self.torque_sign == TorqueSign::Minus)]);
            return write!(
                f,
                "the torques contain gravity, and their sign is {sign}: they are {slope:.2} times the torques of \
                 gravity ({gravity} N·m), and {residual} N·m remain unexplained{}",
                if self.evidence.is_laden() {
                    "; the arm carries more than its file says: see --payload-mass-kg, or `palpate identify`"
                } else {
                    ""
                }
            );
        }
        write!(
            f,
            "the torques contain no gravity, and their sign is {sign}: they are {torque} N·m, gravity would be \
             {gravity} N·m; they take up to {} J of work from the arm, and do up to {} J of work on it",
            number(work.taken),
            number(work.done)
        )
    }
}

impl fmt::Display for Undecided {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (Self::Ambiguous(of) | Self::Sign(of) | Self::NoFit(of)) = self;
        let ConventionEvidence {
            torque, gravity, after_gravity: [plus, minus], slope, work, ..
        } = of;
        let [torque, gravity, plus, minus, taken, done] =
            [*torque, *gravity, *plus, *minus, work.taken, work.done].map(number);
        match self {
            Self::Ambiguous(_) => write!(
                f,
                "the data do not show whether the torques contain gravity: they are {torque} N·m, gravity would be \
                 {gravity} N·m, and without gravity they are {plus} N·m (sign plus) or {minus} N·m (sign minus); give \
                 --gravity included or removed, and --torque-sign"
            ),
            Self::Sign(_) => write!(
                f,
                "the torques contain no gravity (they are {torque} N·m, gravity would be {gravity} N·m), so gravity \
                 does not show their sign, and neither does their work (up to {taken} J taken from the arm, {done} J \
                 done on it); give --torque-sign plus if they are what the object exerts on the joints, minus if they \
                 are what the motors exert"
            ),
            Self::NoFit(_) => write!(
                f,
                "no combination of sign and gravity explains the torques: they are {torque} N·m, {slope:.2} times \
                 the torques of gravity ({gravity} N·m); {}",
                if of.negated_joints().is_some() {
                    "some joints have the opposite sign of the others: `palpate inspect` names them; negate their \
                     columns in the log, or give both --torque-sign and --gravity to read them as they are"
                } else if IN_THOUSANDTHS.contains(&slope.abs()) {
                    "are they in mN·m? wanted N·m"
                } else if of.is_like_currents() {
                    "they seem to be motor currents: `palpate identify` finds the gains of the motors from free motion, \
                     and --arm reads the file that it writes; if they are torques, give both --torque-sign and \
                     --gravity"
                } else {
                    "a unit, the robot, a payload or the order of the joints may be wrong, the torque of a joint may \
                     be missing, or these may be motor currents, not torques"
                }
            ),
        }
    }
}

impl Work {
    /// The work of the torques of some touches, minus the tare if the arm is at rest at the start.
    fn of(robot: &Robot, touches: &[&[Sample]], still_rad: f64) -> Self {
        let mut sum = Self::default();
        for touch in touches {
            let Some(start) = touch.first() else { continue };
            let stays = |sample: &&Sample| {
                let way = robot.difference(&start.q, &sample.q);
                way.iter().all(|way| way.abs() <= still_rad)
            };
            let still = touch.iter().take_while(stays).count();
            let tare = match still {
                0..MIN_TARE => vec![0.0; start.tau.len()],
                _ => mean(&touch[..still], |sample| &sample.tau),
            };
            let mut work = 0.0;
            let [mut most, mut least] = [0.0_f64; 2];
            for pair in touch.windows(2) {
                let way = robot.difference(&pair[0].q, &pair[1].q);
                let torques = pair[0].tau.iter().zip(&pair[1].tau).zip(&tare);
                let mean = torques.map(|((a, b), tare)| f64::midpoint(*a, *b) - tare);
                let step: f64 = mean.zip(way).map(|(tau, way)| tau * way).sum();
                work += if step.is_finite() { step } else { 0.0 };
                (most, least) = (most.max(work), least.min(work));
            }
            sum.done += most;
            sum.taken -= least;
        }
        sum
    }

    /// The sign under which the arm gets almost no energy from contacts; `None` if that is not clear.
    fn sign(self) -> Option<TorqueSign> {
        let Self { done, taken } = self;
        let (more, less) = (done.max(taken), done.min(taken));
        let clear = more > MIN_WORK_J && less <= MAX_BACK * more;
        clear.then_some(if taken > done { TorqueSign::Plus } else { TorqueSign::Minus })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A touch of a built-in arm: at rest, then the shoulder turns to and fro against a spring with friction.
    fn touch(sign: f64, gravity: f64, [spring, friction]: [f64; 2]) -> Vec<Sample> {
        let robot = Robot::built_in("kinova_gen3").unwrap();
        let at = |step: usize| {
            let angle = 0.6 * (0.03 * step.saturating_sub(20) as f64).sin().abs();
            vec![0.2, 0.5 + angle, 0.1, 1.2, 0.3, 0.4, 0.0]
        };
        let sample = |step: usize| {
            let (q, before) = (at(step), at(step.saturating_sub(1)));
            let mut tau = robot.gravity_torque(&robot.forward(&q).unwrap()) * gravity;
            let speed = q[1] - before[1];
            tau[1] +=
                -spring * (q[1] - 0.5) - if speed == 0.0 { 0.0 } else { friction * speed.signum() };
            Sample::new(None, q, tau.iter().map(|tau| sign * tau).collect())
        };
        (0..300).map(sample).collect()
    }

    fn decide(
        touch: &[Sample],
        given: KnownConvention,
    ) -> Result<(TorqueSign, Gravity), Undecided> {
        let robot = Robot::built_in("kinova_gen3").unwrap();
        let found = ConventionEvidence::of(&robot, &[touch], 0.002).unwrap().decide(given)?;
        Ok((found.torque_sign, found.gravity))
    }

    #[test]
    fn every_convention_is_found_from_the_data() {
        for (sign, torque_sign) in [(1.0, TorqueSign::Plus), (-1.0, TorqueSign::Minus)] {
            for (part, gravity) in [(1.0, Gravity::Included), (0.0, Gravity::Removed)] {
                for contact in [[8.0, 0.0], [8.0, 1.0], [0.0, 1.0]] {
                    let found = decide(&touch(sign, part, contact), KnownConvention::default());
                    assert_eq!(found, Ok((torque_sign, gravity)), "{contact:?}");
                }
            }
        }
    }

    #[test]
    fn an_undecided_convention_is_an_error_and_not_guessed() {
        // A constant torque at a joint that does not move does no work.
        let mut silent = touch(1.0, 0.0, [0.0, 0.0]);
        silent.iter_mut().skip(25).for_each(|sample| sample.tau[0] = 2.0);
        let found = decide(&silent, KnownConvention::default());
        assert!(matches!(found, Err(Undecided::Sign(_))), "{found:?}");
        let minus = KnownConvention { torque_sign: Some(TorqueSign::Minus), gravity: None };
        assert_eq!(decide(&silent, minus), Ok((TorqueSign::Minus, Gravity::Removed)));
        // A motor's current follows gravity, and is no torque.
        let found = decide(&touch(-1.0, 0.12, [0.0, 0.05]), KnownConvention::default());
        assert!(matches!(found, Err(Undecided::NoFit(_))), "{found:?}");
        // An arm with a payload that is not in its file.
        let found = decide(&touch(-1.0, 1.6, [0.0, 0.05]), KnownConvention::default());
        assert_eq!(found, Ok((TorqueSign::Minus, Gravity::Included)));
        // Half of gravity could be either.
        let found = decide(&touch(1.0, 0.5, [0.0, 0.05]), KnownConvention::default());
        assert!(matches!(found, Err(Undecided::Ambiguous(_))), "{found:?}");
    }

    #[test]
    fn negated_columns_are_no_proof_that_gravity_is_removed() {
        // Two joints with about as much gravity, so that the sum shows neither sign.
        let gravity = |step: usize| vec![8.0 + (0.1 * step as f64).sin(), -8.0];
        let pairs = |signs: [f64; 2]| -> Vec<_> {
            let tau = |step| gravity(step).iter().zip(signs).map(|(g, sign)| sign * g).collect();
            (0..100).map(|step| (gravity(step), tau(step))).collect()
        };
        assert_eq!(joints_by_sign(&pairs([1.0, -1.0])), [0b01, 0b10]);
        assert_eq!(joints_by_sign(&pairs([-1.0, -1.0])), [0, 0b11]);
        assert_eq!(joints_by_sign(&pairs([1.0, 0.1])), [0b01, 0]);
        let mut evidence = ConventionEvidence::of(
            &Robot::built_in("kinova_gen3").unwrap(),
            &[&touch(1.0, 0.0, [8.0, 1.0])],
            0.002,
        )
        .unwrap();
        assert_eq!(evidence.decide(KnownConvention::default()).unwrap().gravity, Gravity::Removed);
        evidence.joints_by_sign = [0b01, 0b10];
        let refused = evidence.decide(KnownConvention::default()).unwrap_err().to_string();
        assert!(refused.contains("opposite sign of the others"), "{refused}");
    }

    #[test]
    fn pauses_without_any_torque_do_not_hide_the_rest() {
        let mut touch = touch(-1.0, 0.0, [8.0, 1.0]);
        let silent = |sample: &Sample| Sample::new(None, sample.q.clone(), vec![0.0; 7]);
        let end = silent(touch.last().unwrap());
        touch.extend(std::iter::repeat_n(end, 400));
        let found = decide(&touch, KnownConvention::default());
        assert_eq!(found, Ok((TorqueSign::Minus, Gravity::Removed)));
        let silent: Vec<Sample> = touch.iter().map(silent).collect();
        let found = decide(&silent, KnownConvention::default());
        assert_eq!(found, Ok((TorqueSign::Plus, Gravity::Removed)));
    }

    #[test]
    fn a_given_part_of_the_convention_is_kept_and_the_rest_is_found() {
        let given = KnownConvention { torque_sign: None, gravity: Some(Gravity::Removed) };
        let found = decide(&touch(-1.0, 0.0, [8.0, 1.0]), given);
        assert_eq!(found, Ok((TorqueSign::Minus, Gravity::Removed)));
        let given = KnownConvention { torque_sign: Some(TorqueSign::Minus), gravity: None };
        let found = decide(&touch(-1.0, 1.0, [8.0, 1.0]), given);
        assert_eq!(found, Ok((TorqueSign::Minus, Gravity::Included)));
    }
}
