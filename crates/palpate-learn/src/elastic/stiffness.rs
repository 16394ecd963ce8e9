//! Fit of contact and stiffness to the measured torques of touches.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use palpate::unstable::{ElasticBody, ElasticVariant, limit_norm};

use super::simulated::{BodyTorques, CONTACT_CANDIDATES, Simulated, UNTOUCHED};
use crate::tracked::TrackedTouches;

/// Number of stiffness factors that are tried, from 0.1 to 10.
const FACTORS: usize = 81;
/// Frames below this torque have no relative error, N·m.
const TORQUE_FLOOR: f64 = 1.0;

/// Penalty on contacts without creep, in units of the relative error of one touch; contacts that differ from
/// the usual one in friction alone have half of it. On five simulated plants (seeds 50, 51, 54, 58, 60) it
/// lowers the mean relative error after one touch by 0.005, and after nine by 0.007.
const CONTACT_PENALTY: f64 = 0.1;
/// Prior standard deviation of a tree's factor, relative to the common factor.
const TREE_SPREAD: f64 = 1.0;
/// Touches do not determine the stiffness of a tree whose share of the squared torques is smaller than this.
const MIN_SHARE: f64 = 0.01;
/// Effective number of independent frames in a touch.
const FRAMES_THAT_DIFFER: f64 = 3.0;
/// Smaller relative errors count as this in the noise, against overfitting.
const BEST_ERROR: f64 = 0.2;
/// The torque of the bodies is limited to this many times the largest torque of the training touches.
const TORQUE_LIMIT: f64 = 2.0;
/// Stiffness factor of an object that was not touched. A body that is too stiff has larger errors than one
/// that is too soft: on eight simulated plants (seeds 50 to 55, 58, 60) the mean relative error is 0.73 with
/// a factor of 1, and 0.59 with 0.6.
const UNTOUCHED_FACTOR: f64 = 0.6;
/// Penalty on the squared logarithm of factor / [`UNTOUCHED_FACTOR`], in units of the relative error of one
/// touch. On the five plants above it lowers the mean relative error after one touch from 0.76 to 0.71, and
/// does not change it after nine.
const PRIOR_WEIGHT: f64 = 0.2;

/// Contact and stiffness of an object's bodies, fitted to training touches.
#[derive(Debug, Clone, PartialEq)]
pub struct ElasticParameters {
    /// Index in [`CONTACT_CANDIDATES`].
    contact: usize,
    /// By body.
    shares: Vec<Share>,
    /// The norm to which the torque of the bodies is limited, N·m over all joints; infinite without a touch.
    torque_limit_n_m: f64,
}

/// Weight and stiffness of one of several bodies.
#[derive(Debug, Clone, PartialEq)]
struct Share {
    /// Weight of the body's torque; the weights of all bodies sum to 1.
    weight: f64,
    /// Factors on the stiffness of the springs, by tree.
    factors: DVector<f64>,
}

impl ElasticParameters {
    /// Sliding friction between arm and body.
    pub fn friction(&self) -> f64 {
        CONTACT_CANDIDATES[self.contact][0]
    }

    /// [`palpate::unstable::ElasticContactConfig::creep_s`], s.
    pub(crate) fn creep_s(&self) -> f64 {
        CONTACT_CANDIDATES[self.contact][1]
    }

    /// The norm to which the torque of the bodies is limited, N·m; `None` without touches.
    pub(super) fn torque_limit_n_m(&self) -> Option<f64> {
        self.torque_limit_n_m.is_finite().then_some(self.torque_limit_n_m)
    }

    /// Factors on the stiffness of the springs of each tree, for the body with the largest weight.
    pub fn by_tree(&self) -> impl Iterator<Item = f64> {
        let most = self.shares.iter().rev().max_by(|a, b| a.weight.total_cmp(&b.weight));
        most.into_iter().flat_map(|share| share.factors.iter().copied())
    }

    /// Mean factor on the stiffness of the springs, over trees and (weighted) bodies.
    pub fn stiffness_factor(&self) -> f64 {
        self.shares.iter().map(|share| share.weight * share.factors.mean()).sum()
    }
}

impl BodyTorques {
    /// Torque of the bodies in a frame, n_joints, N·m.
    pub(super) fn torque(
        &self,
        constants: &ElasticParameters,
        touch: usize,
        frame: usize,
    ) -> DVector<f64> {
        let bodies = self.torques(constants.contact).iter().zip(&constants.shares);
        let torque: DVector<f64> = bodies
            .map(|(torques, share)| &torques[touch][frame] * &share.factors * share.weight)
            .sum();
        limit_norm(torque, constants.torque_limit_n_m)
    }

    /// The bodies with their learnt weights and stiffness factors.
    pub(super) fn variants(&self, constants: &ElasticParameters) -> Vec<ElasticVariant> {
        let variant = |(body, share): (&Arc<ElasticBody>, &Share)| ElasticVariant {
            body: ElasticBody::clone(body),
            weight: share.weight.min(1.0),
            stiffness_factors: share.factors.as_slice().to_vec(),
        };
        self.bodies.iter().zip(&constants.shares).map(variant).collect()
    }

    /// The contact with which the first body explains the measured torques of these touches best, with
    /// the penalty, and the sum of its relative errors without the penalty.
    pub(super) fn contact(&self, tracked: &TrackedTouches, touches: &[usize]) -> (usize, f64) {
        let touches = &with_torque(tracked, touches)[..];
        if touches.is_empty() {
            return (UNTOUCHED, 0.0);
        }
        let error = |contact| factors((self.first(contact), &self.bodies[0]), tracked, touches).1;
        let penalty = |contact: usize| {
            let [usual, this] = [UNTOUCHED, contact].map(|contact| CONTACT_CANDIDATES[contact]);
            match (this == usual, this[1] == usual[1]) {
                (true, _) => 0.0,
                (false, true) => 0.5 * CONTACT_PENALTY,
                (false, false) => CONTACT_PENALTY,
            }
        };
        let cost = |(contact, error): &(usize, f64)| error + penalty(*contact);
        let errors = (0..CONTACT_CANDIDATES.len()).map(|contact| (contact, error(contact)));
        let best = errors.min_by(|a, b| cost(a).total_cmp(&cost(b)));
        best.expect("there are contacts")
    }

    /// Contact and stiffness that explain the measured torques of these touches best: with the least
    /// mean over touches of the average relative error, plus penalties.
    pub(super) fn constants(
        &self,
        tracked: &TrackedTouches,
        touches: &[usize],
    ) -> ElasticParameters {
        let touches = &with_torque(tracked, touches)[..];
        let (contact, _) = self.contact(tracked, touches);
        let bodies = self.torques(contact).iter().zip(&self.bodies);
        let shares = bodies.map(|(torques, body)| {
            let (factors, error) = factors((torques, body), tracked, touches);
            Share { weight: f64::max(error, 1e-6).powi(-8), factors }
        });
        let mut shares: Vec<Share> = shares.collect();
        let sum: f64 = shares.iter().map(|share| share.weight).sum();
        shares.iter_mut().for_each(|share| share.weight /= sum);
        let frames = touches.iter().flat_map(|&touch| &tracked.touches[touch].frames);
        let largest = frames.map(|frame| frame.observation.tau().norm()).fold(0.0, f64::max);
        let limit = if touches.is_empty() { f64::INFINITY } else { TORQUE_LIMIT * largest };
        ElasticParameters { contact, shares, torque_limit_n_m: limit }
    }
}

/// The touches with a frame of at least [`TORQUE_FLOOR`]; others do not determine the stiffness.
pub(crate) fn with_torque(tracked: &TrackedTouches, touches: &[usize]) -> Vec<usize> {
    let has_torque = |touch: &&usize| {
        let frames = &tracked.touches[**touch].frames;
        frames.iter().any(|frame| frame.observation.tau().norm() >= TORQUE_FLOOR)
    };
    touches.iter().filter(has_torque).copied().collect()
}

/// The stiffness factors by tree that explain the measured torques of these touches best, and the sum over
/// touches of the average relative errors.
fn factors(
    (torques, body): (&Simulated, &ElasticBody),
    tracked: &TrackedTouches,
    touches: &[usize],
) -> (DVector<f64>, f64) {
    let n_trees = body.n_trees();
    if touches.is_empty() {
        return (DVector::from_element(n_trees, UNTOUCHED_FACTOR), 0.0);
    }
    let error = |factors: &DVector<f64>| -> f64 {
        let error =
            |&touch: &usize| touch_error(tracked, touch, |frame| &torques[touch][frame] * factors);
        touches.iter().map(error).sum()
    };
    let tried = (0..FACTORS).map(|number| {
        let factor = 0.1 * 100_f64.powf(number as f64 / (FACTORS - 1) as f64);
        let factors = DVector::from_element(n_trees, factor);
        let error = error(&factors);
        let apart = (factor / UNTOUCHED_FACTOR).ln();
        (number, error, error + PRIOR_WEIGHT * apart * apart, factors)
    });
    let tried: Vec<_> = tried.collect();
    let best = tried.iter().min_by(|a, b| a.1.total_cmp(&b.1)).expect("there are factors");
    if best.0 == 0 || best.0 == FACTORS - 1 {
        // The best factor is at the end of the range: this body does not fit the object, so it gets no torque.
        let none = DVector::zeros(n_trees);
        let error = error(&none);
        return (none, error);
    }
    let best = tried.into_iter().min_by(|a, b| a.2.total_cmp(&b.2)).expect("there are factors");
    let mut common = (best.3, best.1);
    if body.has_blocks() {
        // A material that was not touched may have any stiffness, so it keeps the untouched factor: on a cushion of
        // two materials (cushion_a), this lowers the error after a touch of the stiffer one from 1.28 to 0.42.
        let unmet = unmet(torques, touches, &common.0);
        let factors = common.0.iter_mut().zip(unmet);
        factors.filter(|(_, unmet)| *unmet).for_each(|(factor, _)| *factor = UNTOUCHED_FACTOR);
    }
    // With more trees than touches, factors by tree would be overfitted.
    if n_trees == 1 || n_trees > touches.len() {
        return common;
    }
    let by_tree = by_tree(torques, tracked, touches, &common.0);
    let then = error(&by_tree);
    if then < common.1 { (by_tree, then) } else { common }
}

/// By tree, whether its share of the torques is too small to determine its stiffness ([`MIN_SHARE`]).
fn unmet(torques: &Simulated, touches: &[usize], factors: &DVector<f64>) -> Vec<bool> {
    let mut squares = DVector::<f64>::zeros(factors.len());
    for &touch in touches {
        for by_tree in &torques[touch] {
            for (tree, torque) in by_tree.column_iter().enumerate() {
                squares[tree] += torque.norm_squared() * factors[tree].powi(2);
            }
        }
    }
    let least = MIN_SHARE * squares.sum();
    squares.iter().map(|&square| square < least).collect()
}

/// Factors by tree, regularised towards the common ones: ridge regression on the relative error of the
/// touches' frames.
fn by_tree(
    torques: &Simulated,
    tracked: &TrackedTouches,
    touches: &[usize],
    common: &DVector<f64>,
) -> DVector<f64> {
    let n = common.len();
    let (mut curvature, mut slope) = (DMatrix::zeros(n, n), DVector::zeros(n));
    let (mut residual, mut count) = (0.0, 0.0_f64);
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
            residual += each * off.norm_squared();
            curvature += by_tree.tr_mul(&by_tree) * each;
            slope += by_tree.tr_mul(&off) * each;
        }
    }
    // A fixed point: the residual gives the noise, the noise gives the ridge, and the ridge changes the residual.
    let mut change = DVector::zeros(n);
    for _ in 0..3 {
        let residual = residual + change.dot(&(&curvature * &change - 2.0 * &slope));
        let noise = f64::max(residual / count.max(1.0), BEST_ERROR.powi(2)) / FRAMES_THAT_DIFFER;
        let ridge = DMatrix::from_diagonal_element(n, n, noise / TREE_SPREAD.powi(2));
        let Some(held) = (&curvature + ridge).cholesky() else { break };
        change = held.solve(&slope);
    }
    common.zip_map(&change, |common, change| common * (1.0 + change).clamp(0.1, 10.0))
}

/// The average relative error of a touch against the measured torque; 0 if no frame reaches [`TORQUE_FLOOR`].
pub(super) fn touch_error(
    tracked: &TrackedTouches,
    touch: usize,
    predict: impl Fn(usize) -> DVector<f64>,
) -> f64 {
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
