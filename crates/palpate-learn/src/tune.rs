//! Settings chosen by cross-validation inside training touches.
//!
//! Candidates are made once, the given settings among them: a few contact models, each with a few priors
//! ([`Search::quick`]), or contact model, prior, torque noise and replays drawn at random from a seed, and one for hard
//! objects ([`Search::thorough`]). Successive halving then finds the best: every candidate is tried on half of a few
//! inner folds, the better third also on the other half, and in a thorough search the best third of these
//! leave-one-touch-out. Candidates are scored by the measured torques of held-out training touches; the touch under
//! test is never used. The same torques give the candidate's [`palpate::EstimatorConfig::stiffness_scale`]: the one
//! with the smallest error.
//!
//! Frames are thinned for this. If every n-th is kept, the torque noise is divided by √n, so that evidence and prior
//! keep their balance. A contact model is simulated once for all candidates and folds that share it.

use std::sync::Arc;

use palpate::{Arm, ContactConfig, EstimatorKind, MapperConfig};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::{LearnError, Stop};
use crate::evaluation::MeanStd;
use crate::folds::{Fold, among};
use crate::method::Method;
use crate::own_motion::{Explained, OwnMotion};
use crate::study::for_thinned;
use crate::torque_errors::ErrorSum;
use crate::tracked::{TouchSamples, TrackedTouches};

/// Contact distance, m, friction and Coulomb friction of the contact models that are tried besides the given one.
/// Objects differ most in these. Chosen on 18 simulated objects: the default, the two with the smallest mean error, and
/// those that then reduce the error most.
const CONTACTS: [[f64; 3]; 6] = [
    [0.024, 0.3, 0.0],
    [0.030, 0.05, 0.3],
    [0.030, 0.3, 0.0],
    [0.036, 0.05, 0.0],
    [0.036, 0.05, 0.3],
    [0.036, 0.3, 0.0],
];
/// Contact model for hard objects that only the tool touches: the best on real presses of rigid buttons, and not chosen
/// for any of 25 simulated objects.
const HARD_CONTACT: [f64; 3] = [0.008, 0.05, 0.0];
/// Prior standard deviation for hard objects in a thorough search, as a multiple of the given one.
const HARD_PRIOR_STD: f64 = 4.0;
/// Increases of the prior mean, as multiples of the given prior standard deviation.
const PRIOR_MEANS: [f64; 4] = [0.0, 0.016, 0.04, 0.08];
/// Priors of a quick search: increase of the mean, and standard deviation, as multiples of the given standard
/// deviation.
const QUICK_PRIORS: [(f64, f64); 6] =
    [(0.0, 1.0), (0.016, 1.0), (0.04, 1.0), (0.08, 1.0), (0.0, 2.0), (0.0, 4.0)];
/// Prior standard deviations and torque noise, as multiples of the given ones; replays after each frame.
const PRIOR_STDS: [f64; 5] = [0.5, 1.0, 1.5, 2.0, 4.0];
const TORQUE_STDS: [f64; 3] = [0.7, 1.0, 1.4];
const REPLAYS: [u32; 3] = [10, 20, 40];

/// If the best score is above this, touches do not predict each other ([`Tuned::is_all_noise`]).
const MAX_ERROR: f64 = 0.95;
/// From these shares on ([`Tuner::own_motion`]), torques follow the arm's own motion: always, or if the score of its
/// friction and inertia is lower than that of the field by the margin. The smaller share was 0.48 to 0.95 in 33 simulated
/// sets of free motion, and 0.38 to 0.94 in real ones. In touches it was at most 0.25; only where a tool was dragged over
/// a surface with a sliding friction of 1, up to 0.59, but there the field had the lower score.
const OWN_MOTION: f64 = 0.65;
const MAYBE_OWN_MOTION: f64 = 0.35;
const OWN_MOTION_MARGIN: f64 = 0.1;
/// About the most frames, over all touches, that a candidate learns and predicts: in a thorough and in a quick search.
const FRAMES: usize = 1_200;
const QUICK_FRAMES: usize = 300;
/// About the most frames at which the arm's own motion is computed.
const MOTION_FRAMES: usize = 5_000;
/// With more contacts in a frame than this, in the mean, a candidate learns and predicts fewer frames.
const MANY_CONTACTS: f64 = 6_000.0;
/// Inner folds of the first two rounds; the last round is leave-one-touch-out.
const INNER: usize = 4;
/// Number of stiffness scales that are compared, evenly spaced down from 1, without 0.
const SCALES: u32 = 20;

/// Size of a thorough search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SearchBudget {
    /// Number of candidates in the first round.
    pub candidates: usize,
    /// Seed of the random candidates.
    pub seed: u64,
}

impl SearchBudget {
    /// As many candidates as a few minutes on two cores allow; `ekf` takes three times as long as `map`.
    pub fn of(method: EstimatorKind) -> Self {
        let candidates = match method {
            EstimatorKind::Map | EstimatorKind::Elastic => 24,
            EstimatorKind::Ekf => 12,
        };
        Self { candidates, seed: 0 }
    }
}

/// Which settings the user has given: a quick search does not change them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FixedSettings {
    /// Contact distance δ.
    pub contact_distance: bool,
    /// Friction μ.
    pub friction: bool,
    /// Coulomb friction.
    pub coulomb_friction: bool,
    /// Mean of the prior.
    pub prior_mean: bool,
    /// Standard deviation of the prior.
    pub prior_std: bool,
    /// Torque noise.
    pub torque_std: bool,
    /// Stiffness scale.
    pub stiffness_scale: bool,
}

/// Candidates, and how thoroughly they are compared.
#[derive(Debug, Clone, PartialEq)]
pub struct Search {
    candidates: Vec<MapperConfig>,
    given: FixedSettings,
    /// About the most frames that a candidate learns and predicts.
    frames: usize,
    /// Whether there is a last round of leave-one-touch-out.
    one_by_one: bool,
}

impl Search {
    /// Few candidates, which differ only in settings that the user has not given. Takes seconds for ten touches.
    pub fn quick(config: &MapperConfig, given: FixedSettings) -> Self {
        let mut candidates = vec![config.clone()];
        for model in CONTACTS.into_iter().chain([HARD_CONTACT]) {
            for (mean, std) in QUICK_PRIORS {
                let mut candidate = config.clone();
                let (contact, prior) = (&mut candidate.contact, &mut candidate.estimator.prior);
                set_contact(contact, model, given);
                if !given.prior_mean {
                    prior.mean_n_per_m += mean * prior.std_n_per_m;
                }
                if !given.prior_std {
                    prior.std_n_per_m *= std;
                }
                if contact.check().is_ok() && !candidates.contains(&candidate) {
                    candidates.push(candidate);
                }
            }
        }
        Self { candidates, given, frames: QUICK_FRAMES, one_by_one: false }
    }

    /// Candidates drawn at random around the given settings. Takes minutes for ten touches.
    pub fn thorough(config: &MapperConfig, budget: SearchBudget) -> Self {
        let (candidates, given) = (draw(config, budget), FixedSettings::default());
        Self { candidates, given, frames: FRAMES, one_by_one: true }
    }

    /// Whether it is a quick search.
    pub fn is_quick(&self) -> bool {
        !self.one_by_one
    }

    /// Number of candidates.
    pub fn candidates(&self) -> usize {
        self.candidates.len()
    }
}

/// The chosen settings, and the scores of all candidates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Tuned {
    /// The best settings.
    pub config: MapperConfig,
    /// All candidates, sorted by the number of their rounds (most first), then by score.
    pub trials: Vec<Trial>,
    /// Whether touches hardly predict each other, or their torques follow the arm's own motion. `torque_std` is then so
    /// large that it explains all of their torque.
    pub is_all_noise: bool,
    /// If the torques follow the arm's own motion rather than contacts: the share of the squared torque, while the arm
    /// moves, that its friction and inertia explain.
    #[serde(default)]
    pub own_motion: Option<f64>,
}

/// A candidate and its scores.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Settings of the candidate.
    pub config: MapperConfig,
    /// Score after each of its rounds: mean relative error on held-out training touches (of a touch below 1 N·m: mean
    /// error over that of predicting zero), plus the relative excess over the error of predicting zero, if any.
    pub scores: Vec<f64>,
}

/// Scores of a touch under each stiffness scale.
type ByScale = Vec<Score>;

/// Candidates with simulated contacts, for any set of training touches.
pub struct Tuner {
    search: Search,
    /// The touches under each contact model.
    tracked: Vec<(ContactConfig, TrackedTouches)>,
    /// `tracked` has every n-th learnt sample; this is n.
    every: usize,
    motion: OwnMotion,
}

impl Tuner {
    /// Simulates the contact models of the candidates, in parallel.
    ///
    /// `base` are the touches tracked under the contact model and the lattice of `config`; `done` is called for every
    /// candidate, from any thread, for a progress bar.
    ///
    /// # Errors
    ///
    /// If the given settings are out of their range, or on being stopped.
    pub fn new(
        (arm, touches, base): (&Arc<Arm>, &[TouchSamples], &TrackedTouches),
        config: &MapperConfig,
        search: Search,
        stop: Stop<'_>,
        done: &(dyn Fn() + Sync),
    ) -> Result<Self, LearnError> {
        drop(config.estimator(base.n_joints)?); // refused before anything is simulated
        let frames: usize = base.touches.iter().map(|touch| touch.frames.len()).sum();
        let most =
            (search.frames as f64 * (MANY_CONTACTS / base.contacts_per_frame()).min(1.0)) as usize;
        let every = frames.div_ceil(most.max(1)).max(1);
        let mut models: Vec<&ContactConfig> = Vec::new();
        for MapperConfig { contact, .. } in &search.candidates {
            if !models.contains(&contact) {
                models.push(contact);
            }
        }
        let of_model = |contact: &ContactConfig| {
            let frames = if *contact == config.contact {
                base.thinned(every)
            } else {
                base.with_contact_model(contact, arm, config, (touches, every), stop)?
            };
            let sharing = search.candidates.iter().filter(|own| own.contact == *contact);
            sharing.for_each(|_| done());
            Ok((contact.clone(), frames))
        };
        let tracked: Vec<Result<_, LearnError>> = models.into_par_iter().map(of_model).collect();
        let tracked = tracked.into_iter().collect::<Result<_, _>>()?;
        let motion = OwnMotion::of(&arm.robot, &base.motions, MOTION_FRAMES);
        let every = every * base.thinning;
        Ok(Self { search, tracked, every, motion })
    }

    /// Chooses the settings for the training touches `train`.
    ///
    /// # Errors
    ///
    /// If no candidate can learn these touches, or on being stopped.
    pub fn tune(&self, train: &[usize], stop: Stop<'_>) -> Result<Tuned, LearnError> {
        let begun = |config| (Trial { config, scores: Vec::new() }, Vec::new());
        let mut trials: Vec<(Trial, Vec<ByScale>)> =
            self.with_noise_of(train).into_iter().map(begun).collect();
        let mut left = trials.len();
        let all = among(train, train.len());
        let some = among(train, INNER.min(train.len()));
        let (few, others) = some.split_at(some.len().div_ceil(2));
        let rounds = if self.search.one_by_one { 3 } else { 2 };
        for (round, folds) in [few, others, &all].into_iter().enumerate().take(rounds) {
            trials[..left].par_iter_mut().try_for_each(|(trial, held_out)| {
                if round == 2 {
                    held_out.clear(); // leave-one-touch-out tests the same touches again
                }
                held_out.extend(self.held_out(&trial.config, folds, stop)?);
                let (score, scale) = self.best_scale(&trial.config, held_out);
                trial.scores.push(score);
                trial.config.estimator.stiffness_scale = scale;
                Ok::<_, LearnError>(())
            })?;
            // The sort is stable: equal scores keep the order of the round before, at first the order of candidates.
            trials[..left].sort_by(|(a, _), (b, _)| a.scores[round].total_cmp(&b.scores[round]));
            left = [left.div_ceil(3), left.div_ceil(3), 1][round];
        }
        let trials: Vec<Trial> = trials.into_iter().map(|(trial, _)| trial).collect();
        let mut config = trials[0].config.clone();
        let score = trials[0].scores.last().copied().unwrap_or_default();
        // The score under a given scale may be bad because of the scale.
        let given = self.search.given;
        let own_motion = self.own_motion(train, score);
        let is_all_noise = (score > MAX_ERROR || own_motion.is_some())
            && !(given.torque_std || given.stiffness_scale)
            && config.method == EstimatorKind::Map;
        if is_all_noise {
            // Friction repeats itself, so touches that repeat a motion are no independent measurements.
            let measured = if own_motion.is_some() { 1 } else { train.len() };
            config.estimator.torque_std =
                self.all_noise((train, measured), &config.estimator.torque_std);
        }
        Ok(Tuned { config, trials, is_all_noise, own_motion })
    }

    /// [`Tuned::own_motion`], given the score of the field.
    fn own_motion(&self, train: &[usize], score: f64) -> Option<f64> {
        let Explained { share, share_of_frames, touches } = self.motion.explain(train)?;
        let scores =
            touches.iter().filter_map(|[predicted, measured]| score_of(predicted, measured));
        let scores: Vec<Score> = scores.collect();
        let is_own = is_own_motion(share.min(share_of_frames), mean_score(&scores.iter()), score);
        is_own.then_some(share)
    }

    /// Torque noise if touches do not predict each other, n_joints, N·m, at least `least`: the root mean square of the
    /// torque, times the root of the frames per measurement, so that all frames together count as so many `measured`.
    fn all_noise(&self, (train, measured): (&[usize], usize), least: &[f64]) -> Vec<f64> {
        let tracked = &self.tracked[0].1;
        let frames = || train.iter().flat_map(|&touch| tracked.touches[touch].in_contact());
        let count = (frames().count() * self.every).max(1) as f64;
        let of_each = (count / measured.max(1) as f64).max(1.0);
        let square =
            |j: usize| frames().map(|frame| frame.observation.tau()[j].powi(2)).sum::<f64>();
        let mean = |j: usize| square(j) * self.every as f64 / count;
        (0..tracked.n_joints)
            .map(|j| (mean(j) * of_each).sqrt().max(least[j.min(least.len() - 1)]))
            .collect()
    }

    /// The candidates with the noise of the sensors, from the tares of the training touches, added to
    /// their torque noise, unless that is given. The first candidate, with the given settings, stays as it is.
    fn with_noise_of(&self, train: &[usize]) -> Vec<MapperConfig> {
        let noise_std = self.tracked[0].1.noise_std(train);
        let mut candidates = self.search.candidates.clone();
        if self.search.given.torque_std {
            return candidates;
        }
        for candidate in &mut candidates[1..] {
            let given = &candidate.estimator.torque_std;
            let given = |joint: usize| given[joint.min(given.len() - 1)];
            let std = |(joint, noise): (usize, &f64)| given(joint).hypot(*noise);
            candidate.estimator.torque_std = noise_std.iter().enumerate().map(std).collect();
        }
        candidates
    }

    /// Scores of a candidate on the test touches of `folds`, without those that have no torque.
    fn held_out(
        &self,
        config: &MapperConfig,
        folds: &[Fold],
        stop: Stop<'_>,
    ) -> Result<Vec<ByScale>, LearnError> {
        let scales = self.scales(config);
        let mut config = for_thinned(config, self.every);
        config.estimator.stiffness_scale = 1.0;
        let of_model = self.tracked.iter().find(|(contact, _)| *contact == config.contact);
        let (_, tracked) = of_model.expect("the contact models of all candidates were simulated");
        let mut scores = Vec::new();
        for fold in folds {
            let torques = Method::of(config.method).predict(tracked, fold, &config, stop)?;
            for (&touch, predicted) in fold.test.iter().zip(torques) {
                let frames = &tracked.touches[touch].frames;
                let measured = frames.iter().map(|frame| frame.observation.tau());
                let measured: Vec<Vec<f64>> = measured.map(|tau| tau.as_slice().to_vec()).collect();
                let score = |scale: &f64| {
                    let scaled = |tau: &Vec<f64>| tau.iter().map(|tau| scale * tau).collect();
                    let predicted: Vec<Vec<f64>> = predicted.iter().map(scaled).collect();
                    score_of(&predicted, &measured)
                };
                scores.extend(scales.iter().map(score).collect::<Option<ByScale>>());
            }
        }
        Ok(scores)
    }

    /// The stiffness scales that are tried for a candidate.
    fn scales(&self, config: &MapperConfig) -> Vec<f64> {
        let scale = |part: u32| f64::from(SCALES - part) / f64::from(SCALES);
        match Method::of(config.method) {
            Method::Map if !self.search.given.stiffness_scale => (0..SCALES).map(scale).collect(),
            _ => vec![config.estimator.stiffness_scale],
        }
    }

    /// The score of a candidate with its best stiffness scale, and this scale.
    fn best_scale(&self, config: &MapperConfig, held_out: &[ByScale]) -> (f64, f64) {
        let mean = |place: usize| mean_score(&held_out.iter().map(|scores| &scores[place]));
        let scored = self.scales(config).into_iter().enumerate();
        let scored = scored.map(|(place, scale)| (mean(place), scale));
        // Of equal scores, the largest scale, which comes first.
        scored.min_by(|a, b| a.0.total_cmp(&b.0)).expect("there is a scale")
    }
}

/// Whether torques follow the arm's own motion, given the share that it explains, its score and that of the field.
fn is_own_motion(share: f64, score: f64, of_field: f64) -> bool {
    share >= OWN_MOTION || (share >= MAYBE_OWN_MOTION && score < of_field - OWN_MOTION_MARGIN)
}

/// Errors of a held-out touch.
#[derive(Debug, Clone, Copy)]
struct Score {
    /// Mean relative error; if the torque never reaches 1 N·m, the mean error over that of predicting zero.
    relative: f64,
    /// Mean error, N·m.
    error: f64,
    /// Mean error of predicting zero, N·m.
    of_zero: f64,
}

/// The score of a touch; `None` without any torque.
fn score_of(predicted: &[Vec<f64>], measured: &[Vec<f64>]) -> Option<Score> {
    let sum = ErrorSum::of(predicted, measured);
    let (errors, of_zero) = (sum.errors()?, sum.zero()?.avg_error);
    let (error, of_all) = (errors.avg_error, errors.avg_error / of_zero);
    let relative = errors.avg_relative.unwrap_or(of_all);
    (of_zero > 0.0).then_some(Score { relative, error, of_zero })
}

/// The mean relative error of touches. If the sum of their mean errors is above that of predicting zero, the relative
/// excess is added: relative errors are from frames with strong torques, and do not show torques predicted in free air.
fn mean_score<'a>(touches: &(impl Iterator<Item = &'a Score> + Clone)) -> f64 {
    let relative = MeanStd::of(touches.clone().map(|score| score.relative));
    let sum = |of: fn(&Score) -> f64| touches.clone().map(of).sum::<f64>();
    let of_all = sum(|score| score.error) / sum(|score| score.of_zero);
    let excess = if of_all < 1.0 { 0.0 } else { of_all - 1.0 };
    let score = relative.map_or(f64::INFINITY, |relative| relative.mean + excess);
    if score.is_finite() { score } else { f64::INFINITY }
}

/// Random candidates around the given settings. The given settings are the first, those for hard objects the last.
fn draw(config: &MapperConfig, budget: SearchBudget) -> Vec<MapperConfig> {
    let mut rng = ChaCha8Rng::seed_from_u64(budget.seed);
    let mut pick = |n: usize| ((u64::from(rng.next_u32()) * n as u64) >> 32) as usize;
    let mut candidates = vec![config.clone()];
    let tries = 20 * budget.candidates;
    for _ in 0..tries {
        if candidates.len() + 1 >= budget.candidates {
            break; // the last place is for hard objects
        }
        let mut candidate = config.clone();
        if let Some(model) = CONTACTS.get(pick(CONTACTS.len() + 1)) {
            set_contact(&mut candidate.contact, *model, FixedSettings::default());
        }
        let estimator = &mut candidate.estimator;
        let above = PRIOR_MEANS[pick(PRIOR_MEANS.len())] * estimator.prior.std_n_per_m;
        estimator.prior.mean_n_per_m += above;
        estimator.prior.std_n_per_m *= PRIOR_STDS[pick(PRIOR_STDS.len())];
        let scale = TORQUE_STDS[pick(TORQUE_STDS.len())];
        estimator.torque_std.iter_mut().for_each(|std| *std *= scale);
        estimator.replays = REPLAYS[pick(REPLAYS.len())];
        let fits = candidate.contact.check().is_ok();
        // A copy of the first candidate is kept: `with_noise_of` will add the noise of the sensors to all others.
        if fits && !candidates[1..].contains(&candidate) {
            candidates.push(candidate);
        }
    }
    let mut hard = config.clone();
    set_contact(&mut hard.contact, HARD_CONTACT, FixedSettings::default());
    hard.estimator.prior.std_n_per_m *= HARD_PRIOR_STD;
    if candidates.len() < budget.candidates {
        candidates.push(hard);
    }
    candidates
}

/// Sets the parameters of a contact model that the user has not given.
fn set_contact(contact: &mut ContactConfig, model: [f64; 3], given: FixedSettings) {
    let [distance_m, friction, coulomb_friction] = model;
    if !given.contact_distance {
        contact.contact_distance_m = distance_m;
    }
    if !given.friction {
        contact.friction = friction;
    }
    if !given.coulomb_friction {
        contact.coulomb_friction = coulomb_friction;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_that_explains_half_of_the_torque_must_also_predict_better_than_the_field() {
        assert!(is_own_motion(0.7, 0.3, 0.2), "a motion that is repeated");
        assert!(is_own_motion(0.5, 0.7, 0.98), "an FR3 in free motion");
        assert!(!is_own_motion(0.59, 0.71, 0.60), "dragging over a rough surface");
        assert!(!is_own_motion(0.2, 0.5, 0.98), "touches that differ");
    }

    #[test]
    fn the_score_rises_where_predicting_zero_would_be_better() {
        let score = |error| Score { relative: 0.5, error, of_zero: 2.0 };
        let mean = |errors: [f64; 2]| mean_score(&errors.map(score).iter());
        assert!((mean([1.0, 2.6]) - 0.5).abs() < 1e-12, "better than zero over all");
        assert!((mean([1.4, 3.4]) - 0.7).abs() < 1e-12, "a fifth worse");
    }
}
