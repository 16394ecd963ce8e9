//! A body that bends is what is expected, and a field explains what is left over.
//!
//! The torque of an elastic body is in proportion to its stiffness: a touch is simulated once, and the
//! factor of stiffness is fitted afterwards. Where several trees stand side by side, each has a factor of
//! its own, drawn to the common one. Friction changes how the body moves, so every touch is
//! simulated with each of a few kinds of contact ([`CONTACTS`]); the one that explains the training
//! touches best is kept. Where a cloud can be read in several ways, the torques of its bodies are
//! averaged, each with the weight of its error on the training touches to the power of -8.
//! The remaining torque is learnt by `map`.
//!
//! Field, body, and both are averaged, each with the weight of its error to the power of -4: how well it
//! predicted the later training touches before they were learnt. So the result is not much worse than the
//! best of them, also on a touch that is unlike those.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use palpate::unstable::{Cell, ElasticBody, ElasticContactConfig, Equilibrium, Estimator, FrameId};
use palpate::{Arm, MapperConfig, MapperError, RobotError};
use rayon::prelude::*;

use crate::error::{LearnError, Stop, unless_stopped};
use crate::folds::Fold;
use crate::method::Torques;
use crate::tracked::{Touch, Tracked};

/// Contacts between arm and body that are tried: friction, and creep, s
/// ([`ElasticContactConfig::creep_s`]).
pub const CONTACTS: [[f64; 2]; 6] =
    [[0.15, 0.0], [0.4, 0.0], [0.8, 0.0], [0.15, 1e-4], [0.4, 1e-4], [0.8, 1e-4]];
/// Factors of stiffness that are tried, from a tenth to ten.
const FACTORS: usize = 81;
/// Frames below this torque have no relative error, N·m.
const TORQUE_FLOOR: f64 = 1.0;

/// Relative spread of the stiffness of trees about their common factor.
const TREE_SPREAD: f64 = 1.0;
/// Effective number of independent frames in a touch.
const FRAMES_THAT_DIFFER: f64 = 3.0;
/// Least relative error of a body that is not overfitted.
const BEST_ERROR: f64 = 0.2;
/// The torque of the bodies is limited to this many times the largest torque of the training touches.
const TORQUE_LIMIT: f64 = 2.0;

/// n_joints × trees of the body, N·m at a stiffness factor of one, by touch and frame of [`Tracked`].
type Simulated = Vec<Vec<DMatrix<f64>>>;

/// Torque of an object's bodies along every touch.
#[derive(Debug, Clone)]
pub(crate) struct BodyTorques {
    /// Of the first body, with each of [`CONTACTS`].
    first: Vec<Simulated>,
    /// Of the others, with the contacts that may be chosen: those that all touches but one speak for.
    others: Vec<[Option<Simulated>; CONTACTS.len()]>,
    /// Samples, all contacts counted, and those in which the body did not come to rest.
    pub(crate) settled: Settled,
}

/// How often the body came to rest.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Settled {
    /// Samples, each with every contact.
    pub samples: u64,
    /// Those in which the iterations were used up before the body was at rest: its torque is that of the
    /// last iteration.
    pub unsettled: u64,
}

/// What the training touches say of a body.
#[derive(Debug, Clone, PartialEq)]
pub struct Constants {
    /// Which of [`CONTACTS`].
    contact: usize,
    /// By body.
    shares: Vec<Share>,
    /// The norm to which the torque of the bodies is limited, N·m over all joints.
    torque_limit_n_m: f64,
}

/// What the training touches say of one of several bodies.
#[derive(Debug, Clone, PartialEq)]
struct Share {
    /// How far it is believed; they add up to one.
    weight: f64,
    /// Factors on the stiffness of the springs, by tree.
    factors: DVector<f64>,
}

impl Constants {
    /// Sliding friction between arm and body.
    pub fn friction(&self) -> f64 {
        CONTACTS[self.contact][0]
    }

    /// Factors on the stiffness of the springs of each tree, of the body that is believed most.
    pub fn by_tree(&self) -> impl Iterator<Item = f64> {
        let most = self.shares.iter().max_by(|a, b| a.weight.total_cmp(&b.weight));
        most.into_iter().flat_map(|share| share.factors.iter().copied())
    }

    /// Factor on the stiffness of the springs, the mean of trees and bodies.
    pub fn stiffness_factor(&self) -> f64 {
        self.shares.iter().map(|share| share.weight * share.factors.mean()).sum()
    }
}

impl BodyTorques {
    /// How many steps [`Self::new`] counts.
    pub(crate) fn steps(touches: usize, bodies: usize) -> usize {
        touches * (CONTACTS.len() + bodies.saturating_sub(1))
    }

    /// Simulates all touches, several at a time; the result does not depend on how many. `step` is called
    /// after each.
    pub(crate) fn new(
        arm: &Arc<Arm>,
        bodies: &[Arc<ElasticBody>],
        (tracked, touches): (&Tracked, &[Touch]),
        (stop, step): (Stop<'_>, &(dyn Fn() + Sync)),
    ) -> Result<Self, LearnError> {
        let n = touches.len();
        let simulate = |body: &Arc<ElasticBody>, contact: usize, touch: usize| {
            let [friction, creep_s] = CONTACTS[contact];
            let config =
                ElasticContactConfig { friction, creep_s, ..ElasticContactConfig::default() };
            let equilibrium = Equilibrium::new(Arc::clone(arm), Arc::clone(body), config);
            follow(equilibrium, (touch, &touches[touch]), tracked, stop)
        };
        let [first, others @ ..] = bodies else { panic!("the caller gave a body") };
        let jobs = (0..n * CONTACTS.len()).into_par_iter().with_max_len(1);
        let all = jobs.map(|job| simulate(first, job / n, job % n).inspect(|_| step()));
        let (simulated, mut settled) = gathered(all.collect::<Result<_, LearnError>>()?);
        let first: Vec<Simulated> = simulated.chunks(n.max(1)).map(<[_]>::to_vec).collect();

        let mut torques = Self { first, others: Vec::new(), settled };
        let all_but = |left_out: usize| (0..n).filter(move |&touch| touch != left_out).collect();
        let contacts = (0..=n).into_par_iter().map(|left_out| {
            let touches: Vec<usize> = all_but(left_out);
            torques.contact(tracked, &touches).0
        });
        let mut contacts: Vec<usize> = contacts.collect();
        contacts.sort_unstable();
        contacts.dedup();
        for body in others {
            let mut by_contact: [Option<Simulated>; CONTACTS.len()] = Default::default();
            for (number, &contact) in contacts.iter().enumerate() {
                let all = (0..n).into_par_iter().with_max_len(1).map(|touch| {
                    let simulated = simulate(body, contact, touch);
                    simulated.inspect(|_| {
                        if number == 0 {
                            step()
                        }
                    })
                });
                let (simulated, more) = gathered(all.collect::<Result<_, LearnError>>()?);
                settled.samples += more.samples;
                settled.unsettled += more.unsettled;
                by_contact[contact] = Some(simulated);
            }
            torques.others.push(by_contact);
        }
        Ok(Self { settled, ..torques })
    }

    /// Every n-th frame of each touch, from the first on.
    pub(crate) fn thinned(&self, n: usize) -> Self {
        let touch = |frames: &Vec<DMatrix<f64>>| frames.iter().step_by(n.max(1)).cloned().collect();
        let touches = |touches: &Simulated| touches.iter().map(touch).collect();
        let other = |by_contact: &[Option<Simulated>; CONTACTS.len()]| {
            by_contact.each_ref().map(|simulated| simulated.as_ref().map(touches))
        };
        Self {
            first: self.first.iter().map(touches).collect(),
            others: self.others.iter().map(other).collect(),
            settled: self.settled,
        }
    }

    /// The bodies that were simulated with a contact, the first one first.
    fn bodies(&self, contact: usize) -> impl Iterator<Item = &Simulated> {
        let others = self.others.iter().filter_map(move |others| others[contact].as_ref());
        std::iter::once(&self.first[contact]).chain(others)
    }

    /// Torque in a frame, n_joints, N·m.
    fn torque(&self, constants: &Constants, touch: usize, frame: usize) -> DVector<f64> {
        let bodies = self.bodies(constants.contact).zip(&constants.shares);
        let torque: DVector<f64> = bodies
            .map(|(torques, share)| &torques[touch][frame] * &share.factors * share.weight)
            .sum();
        let size = torque.norm();
        if size > constants.torque_limit_n_m {
            torque * (constants.torque_limit_n_m / size)
        } else {
            torque
        }
    }

    /// The contact with which the first body explains the measured torques of some touches best, and the
    /// sum of its errors.
    fn contact(&self, tracked: &Tracked, touches: &[usize]) -> (usize, f64) {
        let errors = self.first.iter().map(|torques| factors(torques, tracked, touches).1);
        let best = errors.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
        best.expect("there are contacts")
    }

    /// Contact and stiffness that explain the measured torques of some touches best: they have the least
    /// mean over touches of the average relative error.
    fn constants(&self, tracked: &Tracked, touches: &[usize]) -> Constants {
        let (contact, _) = self.contact(tracked, touches);
        let shares = self.bodies(contact).map(|torques| {
            let (factors, error) = factors(torques, tracked, touches);
            Share { weight: f64::max(error, 1e-6).powi(-8), factors }
        });
        let mut shares: Vec<Share> = shares.collect();
        let sum: f64 = shares.iter().map(|share| share.weight).sum();
        shares.iter_mut().for_each(|share| share.weight /= sum);
        let frames = touches.iter().flat_map(|&touch| &tracked.touches[touch].frames);
        let largest = frames.map(|frame| frame.observation.tau().norm()).fold(0.0, f64::max);
        Constants { contact, shares, torque_limit_n_m: TORQUE_LIMIT * largest }
    }
}

/// Results in their order, and how often bodies came to rest in all of them.
fn gathered(all: Vec<(Vec<DMatrix<f64>>, Settled)>) -> (Simulated, Settled) {
    let settled = all.iter().fold(Settled::default(), |sum, (_, settled)| Settled {
        samples: sum.samples + settled.samples,
        unsettled: sum.unsettled + settled.unsettled,
    });
    (all.into_iter().map(|(torques, _)| torques).collect(), settled)
}

/// The factors of stiffness that explain the measured torques of some touches best, by tree, and the sum
/// of the average relative errors.
fn factors(torques: &Simulated, tracked: &Tracked, touches: &[usize]) -> (DVector<f64>, f64) {
    let error = |factors: &DVector<f64>| -> f64 {
        let error =
            |&touch: &usize| touch_error(tracked, touch, |frame| &torques[touch][frame] * factors);
        touches.iter().map(error).sum()
    };
    let n_trees = torques.iter().flatten().next().map_or(1, DMatrix::ncols);
    let tried = (0..FACTORS).map(|number| {
        let factor = 0.1 * 100_f64.powf(number as f64 / (FACTORS - 1) as f64);
        let factors = DVector::from_element(n_trees, factor);
        let error = error(&factors);
        (number, factors, error)
    });
    let best = tried.min_by(|a, b| a.2.total_cmp(&b.2)).expect("there are factors");
    if best.0 == 0 || best.0 == FACTORS - 1 {
        // The best factor lies outside of the range: this body is not the object.
        let none = DVector::zeros(n_trees);
        let error = error(&none);
        return (none, error);
    }
    let common = (best.1, best.2);
    // With more trees than touches, factors by tree would be overfitted.
    if n_trees == 1 || n_trees > touches.len() {
        return common;
    }
    let by_tree = by_tree(torques, tracked, touches, &common.0);
    let then = error(&by_tree);
    if then < common.1 { (by_tree, then) } else { common }
}

/// Factors that differ from the common one as far as some touches speak for it: ridge regression on the
/// relative error of their frames.
fn by_tree(
    torques: &Simulated,
    tracked: &Tracked,
    touches: &[usize],
    common: &DVector<f64>,
) -> DVector<f64> {
    let n = common.len();
    let (mut curvature, mut slope) = (DMatrix::zeros(n, n), DVector::zeros(n));
    let (mut left_over, mut count) = (0.0, 0.0_f64);
    for &touch in touches {
        let frames = &tracked.touches[touch].frames;
        let large = |frame: &usize| frames[*frame].observation.tau().norm() >= TORQUE_FLOOR;
        let large: Vec<usize> = (0..frames.len()).filter(large).collect();
        count += if large.is_empty() { 0.0 } else { 1.0 };
        for &frame in &large {
            let tau = frames[frame].observation.tau();
            let each = 1.0 / (large.len() as f64 * tau.norm_squared());
            let mut by_tree = torques[touch][frame].clone();
            by_tree.column_iter_mut().zip(common.iter()).for_each(|(mut one, &by)| one *= by);
            let off = tau - by_tree.column_sum();
            left_over += each * off.norm_squared();
            curvature += by_tree.tr_mul(&by_tree) * each;
            slope += by_tree.tr_mul(&off) * each;
        }
    }
    // The residual gives the noise, and the noise the ridge, which changes the residual.
    let mut change = DVector::zeros(n);
    for _ in 0..3 {
        let left_over = left_over + change.dot(&(&curvature * &change - 2.0 * &slope));
        let noise = f64::max(left_over / count.max(1.0), BEST_ERROR.powi(2)) / FRAMES_THAT_DIFFER;
        let ridge = DMatrix::from_diagonal_element(n, n, noise / TREE_SPREAD.powi(2));
        let Some(held) = (&curvature + ridge).cholesky() else { break };
        change = held.solve(&slope);
    }
    common.zip_map(&change, |common, change| common * (1.0 + change).clamp(0.1, 10.0))
}

/// The body's torque in the frames of a touch.
fn follow(
    mut equilibrium: Equilibrium,
    (number, touch): (usize, &Touch),
    tracked: &Tracked,
    stop: Stop<'_>,
) -> Result<(Vec<DMatrix<f64>>, Settled), LearnError> {
    let frames = &tracked.touches[number].frames;
    let mut torques = Vec::with_capacity(frames.len());
    let mut settled = Settled { samples: touch.samples.len() as u64, unsettled: 0 };
    let mut before_s: Option<f64> = None;
    for (sample, logged) in touch.samples.iter().enumerate() {
        unless_stopped(stop)?;
        let time_s = logged.time_s.zip(before_s).map_or(0.0, |(now, before)| now - before);
        before_s = logged.time_s;
        let at = |error: RobotError| {
            let source = MapperError::from(error);
            LearnError::Sample { touch: number, sample, source }
        };
        let poses = equilibrium.arm().robot.forward(&logged.q).map_err(at)?;
        settled.unsettled += u64::from(equilibrium.advance(&poses, time_s).unsettled > 0);
        if frames.get(torques.len()).is_some_and(|frame| frame.sample as usize == sample) {
            torques.push(equilibrium.torques(&poses));
        }
    }
    assert_eq!(torques.len(), frames.len(), "the touches are those that were tracked");
    Ok((torques, settled))
}

/// How far each is believed; they add up to one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weights {
    /// The field alone.
    pub field: f64,
    /// The body alone.
    pub body: f64,
    /// The body, and the field for what it leaves over.
    pub both: f64,
}

impl Weights {
    /// By the errors of field, body and both.
    fn of(errors: [f64; 3]) -> Self {
        let weights = errors.map(|error| f64::max(error, 1e-6).powi(-4));
        let [field, body, both] = weights.map(|weight| weight / weights.iter().sum::<f64>());
        Self { field, body, both }
    }
}

/// What a fold's training touches say of its test touches.
#[derive(Debug, Clone)]
pub struct Predicted {
    /// Predicted torques of the test touches.
    pub torques: Torques,
    /// Of the body.
    pub constants: Constants,
    /// What predicted them.
    pub weights: Weights,
}

/// A field that learns what the body leaves over, and how well both predicted touches before they were
/// learnt.
struct Learner<'a> {
    body: &'a BodyTorques,
    tracked: &'a Tracked,
    config: &'a MapperConfig,
    /// Nothing for the field alone.
    constants: Option<Constants>,
    estimator: Box<dyn Estimator>,
    error: f64,
}

impl<'a> Learner<'a> {
    fn new(
        (body, tracked): (&'a BodyTorques, &'a Tracked),
        config: &'a MapperConfig,
        constants: Option<Constants>,
    ) -> Result<Self, LearnError> {
        let estimator = config.estimator(tracked.n_joints)?;
        Ok(Self { body, tracked, config, constants, estimator, error: 0.0 })
    }

    fn cells(&self) -> Vec<Cell> {
        self.tracked.with_stiffness(|row| self.estimator.stiffness(row))
    }

    /// Torque of body and field in a frame, n_joints, N·m.
    fn torque(&self, cells: &[Cell], touch: usize, frame: usize) -> DVector<f64> {
        let field = self.tracked.touches[touch].frames[frame].predict(cells);
        DVector::from_vec(field) + self.of_body(touch, frame)
    }

    fn of_body(&self, touch: usize, frame: usize) -> DVector<f64> {
        match &self.constants {
            Some(constants) => self.body.torque(constants, touch, frame),
            None => DVector::zeros(self.tracked.n_joints),
        }
    }

    /// Predicts a touch, if it `counts`, and learns it.
    fn learn(
        &mut self,
        place: usize,
        touch: usize,
        counts: bool,
        stop: Stop<'_>,
    ) -> Result<(), LearnError> {
        if counts {
            let cells = self.cells();
            self.error +=
                touch_error(self.tracked, touch, |frame| self.torque(&cells, touch, frame));
        }
        for (index, frame) in self.tracked.touches[touch].frames.iter().enumerate() {
            unless_stopped(stop)?;
            if frame.observation.n_contacts() == 0 {
                self.estimator.advance_time();
                continue;
            }
            let left_over = frame.observation.tau() - self.of_body(touch, index);
            let observation = frame.observation.clone().with_tau(&left_over);
            let source = FrameId { touch: place as u32, sample: frame.sample };
            self.estimator.correct(&self.tracked.points_m, observation, source)?;
            self.estimator.replay(self.config.estimator.replays);
        }
        Ok(())
    }
}

/// Learns a fold's training touches, and predicts its test touches by field and body.
///
/// # Errors
///
/// If a setting is out of its range, or a frame cannot be used.
///
/// # Panics
///
/// If the touches were tracked without a body ([`Tracked::with_bodies`]).
pub fn predict(
    tracked: &Tracked,
    fold: &Fold,
    config: &MapperConfig,
    stop: Stop<'_>,
) -> Result<Predicted, LearnError> {
    let body = tracked.body.as_deref().expect("the caller gave a body");
    let constants = body.constants(tracked, &fold.train);
    let mut field = Learner::new((body, tracked), config, None)?;
    let mut both = Learner::new((body, tracked), config, Some(constants.clone()))?;
    let mut body_error = 0.0;
    for (place, &touch) in fold.train.iter().enumerate() {
        let counts = 2 * place >= fold.train.len() || fold.train.len() == 1;
        if counts {
            let of_body = |frame: usize| body.torque(&constants, touch, frame);
            body_error += touch_error(tracked, touch, of_body);
        }
        field.learn(place, touch, counts, stop)?;
        both.learn(place, touch, counts, stop)?;
    }
    let weights = Weights::of([field.error, body_error, both.error]);
    let cells = [field.cells(), both.cells()];
    let torque = |touch: usize, frame: usize| {
        weights.field * field.torque(&cells[0], touch, frame)
            + weights.body * body.torque(&constants, touch, frame)
            + weights.both * both.torque(&cells[1], touch, frame)
    };
    let frames = |&touch: &usize| {
        let frames = 0..tracked.touches[touch].frames.len();
        frames.map(|frame| torque(touch, frame).as_slice().to_vec()).collect()
    };
    Ok(Predicted { torques: fold.test.iter().map(frames).collect(), constants, weights })
}

/// The average relative error of a touch against what was measured; 0 if it has none.
fn touch_error(tracked: &Tracked, touch: usize, predict: impl Fn(usize) -> DVector<f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (number, frame) in tracked.touches[touch].frames.iter().enumerate() {
        let tau = frame.observation.tau();
        let size = tau.norm();
        if size >= TORQUE_FLOOR {
            sum += (predict(number) - tau).norm() / size;
            count += 1.0;
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}
