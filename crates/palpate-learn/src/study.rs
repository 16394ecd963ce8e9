//! Comparison of settings over several objects: which settings also hold for objects on which they were not chosen.
//!
//! Each touch of an object is predicted from its others under each of the settings. Contacts are simulated
//! once for all settings that share a contact model. If every n-th frame is kept, the torque noise is divided
//! by √n, so that evidence and prior keep their balance.

use std::sync::Arc;

use palpate::{Arm, MapperConfig};
use rayon::prelude::*;
use serde::Serialize;

use crate::error::{LearnError, Stop};
use crate::evaluation::MeanStd;
use crate::folds::{Fold, folds};
use crate::method::Method;
use crate::torque_errors::ErrorSum;
use crate::tracked::{TouchSamples, TrackedFrame, TrackedTouches};

/// A frame counts as loading if its torque is larger than that many frames before (frames before thinning).
const BEFORE: usize = 5;

/// Errors of a held-out touch.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TouchScore {
    /// Name of the touch.
    pub touch: String,
    /// Average relative error; `None` if the torque never reaches 1 N·m.
    pub relative: Option<f64>,
    /// Average relative error over frames in which the torque grows.
    pub loading: Option<f64>,
    /// Average relative error over frames in which the torque does not grow.
    pub unloading: Option<f64>,
    /// Average relative error over frames in contact of whose cells at least half were touched by learnt touches.
    pub met: Option<f64>,
    /// Average relative error over the other frames in contact.
    pub unmet: Option<f64>,
    /// Root mean square of the error by joint, N·m.
    pub joint_error_n_m: Vec<f64>,
    /// Root mean square of the torque by joint, N·m: the error of predicting zero.
    pub joint_torque_n_m: Vec<f64>,
}

/// Scores of an object.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ObjectScores {
    /// By setting, by touch.
    pub settings: Vec<Vec<TouchScore>>,
    /// Learning curve under the first settings: number of learnt touches (1, 2, 4 and so on), and mean relative error.
    pub by_touches_learnt: Vec<(usize, f64)>,
}

impl ObjectScores {
    /// Mean over touches of the average relative error under each of the settings.
    pub fn relative(&self) -> Vec<Option<f64>> {
        self.settings.iter().map(|touches| mean(touches, |score| score.relative)).collect()
    }
}

/// Mean of a score over the touches that have it.
pub fn mean(touches: &[TouchScore], of: impl Fn(&TouchScore) -> Option<f64>) -> Option<f64> {
    MeanStd::of(touches.iter().filter_map(of)).map(|figure| figure.mean)
}

/// Predicts each touch of an object from its others, under each of `settings`.
///
/// Every `every`-th frame is used. For a learning curve (`curve`), each touch is also predicted from the 1, 2, 4, …
/// touches after it, under the first settings. `done` is called once for each contact model.
///
/// # Errors
///
/// If settings are out of their range, a sample cannot be used, or on being stopped.
///
/// # Panics
///
/// If there are no settings or no touches.
pub fn study(
    (arm, touches): (&Arc<Arm>, &[TouchSamples]),
    settings: &[MapperConfig],
    (every, curve): (usize, bool),
    (stop, done): (Stop<'_>, &dyn Fn()),
) -> Result<ObjectScores, LearnError> {
    assert!(!touches.is_empty(), "there are touches");
    let given = &settings[0];
    let base = TrackedTouches::new(arm, given, touches, stop)?;
    let one_by_one = folds(touches.len(), touches.len());
    let mut scores: Vec<Vec<TouchScore>> = vec![Vec::new(); settings.len()];
    let mut by_touches_learnt = Vec::new();
    while let Some(first) = scores.iter().position(Vec::is_empty) {
        let contact = &settings[first].contact;
        let tracked = match first {
            0 => base.thinned(every),
            _ => base.with_contact_model(contact, arm, given, (touches, every), stop)?,
        };
        let alike: Vec<usize> =
            (0..settings.len()).filter(|&number| settings[number].contact == *contact).collect();
        let parts =
            alike.iter().flat_map(|&number| one_by_one.iter().map(move |fold| (number, fold)));
        let parts: Vec<(usize, &Fold)> = parts.collect();
        let scored: Result<Vec<TouchScore>, LearnError> = parts
            .par_iter()
            .map(|(number, fold)| score(&tracked, fold, (&settings[*number], every), stop))
            .collect();
        for ((number, _), score) in parts.iter().zip(scored?) {
            scores[*number].push(score);
        }
        if first == 0 && curve {
            by_touches_learnt = learning_curve(&tracked, (given, every), stop)?;
        }
        done();
    }
    Ok(ObjectScores { settings: scores, by_touches_learnt })
}

/// Settings for thinned frames, with torque noise divided by √`every`: every `every`-th frame then has as much weight
/// as all frames under `config`.
pub(crate) fn for_thinned(config: &MapperConfig, every: usize) -> MapperConfig {
    let (mut config, shrink) = (config.clone(), (every as f64).sqrt().recip());
    config.estimator.torque_std.iter_mut().for_each(|std| *std *= shrink);
    config
}

/// For each object, the index of the settings that are best on average over all other objects; `None` if no other has a
/// score.
///
/// `relative`: by object, by setting.
pub fn chosen_on_others(relative: &[Vec<Option<f64>>]) -> Vec<Option<usize>> {
    let chosen = |object: usize| {
        let others = || relative.iter().enumerate().filter(move |(other, _)| *other != object);
        let of_setting = |number: usize| {
            MeanStd::of(others().filter_map(|(_, scores)| scores[number])).map(|mean| mean.mean)
        };
        let settings = 0..relative[object].len();
        let scored = settings.filter_map(|number| Some((number, of_setting(number)?)));
        scored.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(number, _)| number)
    };
    (0..relative.len()).map(chosen).collect()
}

fn learning_curve(
    tracked: &TrackedTouches,
    of: (&MapperConfig, usize),
    stop: Stop<'_>,
) -> Result<Vec<(usize, f64)>, LearnError> {
    let n = tracked.touches.len();
    let counts = std::iter::successors(Some(1), |count| Some(2 * count));
    let of_count = |count: usize| {
        let after = |touch: usize| (1..=count).map(move |step| (touch + step) % n).collect();
        let folds = (0..n).map(|touch| Fold { test: vec![touch], train: after(touch) });
        let folds: Vec<Fold> = folds.collect();
        let scores = folds.par_iter().map(|fold| score(tracked, fold, of, stop));
        let scores: Vec<TouchScore> = scores.collect::<Result<_, _>>()?;
        Ok(mean(&scores, |score| score.relative).map(|relative| (count, relative)))
    };
    let figures: Result<Vec<_>, LearnError> =
        counts.take_while(|&count| count < n).map(of_count).collect();
    Ok(figures?.into_iter().flatten().collect())
}

/// Scores the one test touch of a fold; `tracked` has every `every`-th frame.
fn score(
    tracked: &TrackedTouches,
    fold: &Fold,
    (config, every): (&MapperConfig, usize),
    stop: Stop<'_>,
) -> Result<TouchScore, LearnError> {
    let config = for_thinned(config, every);
    let predicted = Method::of(config.method).predict(tracked, fold, &config, stop)?.swap_remove(0);
    let touch = &tracked.touches[fold.test[0]];
    let met = tracked.touched_rows(&fold.train);
    let targets = || touch.frames.iter().map(|frame| &frame.target);
    let loading = loading(&targets().collect::<Vec<_>>(), BEFORE.div_ceil(every));
    let is_met = |frame: &TrackedFrame| mostly_met(frame.observation.rows(), &met);
    let is_met: Vec<Option<bool>> = touch.frames.iter().map(is_met).collect();
    let relative = |wanted: &dyn Fn(usize) -> bool| {
        let mut sum = ErrorSum::default();
        for (at, (predicted, target)) in predicted.iter().zip(targets()).enumerate() {
            if wanted(at) {
                sum.add(predicted, target);
            }
        }
        sum.errors()?.avg_relative
    };
    let frames = touch.frames.len().max(1) as f64;
    let by_joint = |of: &dyn Fn(f64, f64) -> f64| {
        let joint = |joint: usize| {
            let pairs = predicted.iter().zip(targets());
            let square = |(p, t): (&Vec<f64>, &Vec<f64>)| of(p[joint], t[joint]).powi(2);
            (pairs.map(square).sum::<f64>() / frames).sqrt()
        };
        (0..tracked.n_joints).map(joint).collect()
    };
    Ok(TouchScore {
        touch: touch.name.clone(),
        relative: relative(&|_| true),
        loading: relative(&|at| loading[at]),
        unloading: relative(&|at| !loading[at]),
        met: relative(&|at| is_met[at] == Some(true)),
        unmet: relative(&|at| is_met[at] == Some(false)),
        joint_error_n_m: by_joint(&|predicted, target| predicted - target),
        joint_torque_n_m: by_joint(&|_, target| target),
    })
}

/// By frame, whether the norm of its torque is larger than that `before` frames earlier.
fn loading(torques: &[&Vec<f64>], before: usize) -> Vec<bool> {
    let size = |at: usize| torques[at].iter().map(|t| t * t).sum::<f64>();
    (0..torques.len()).map(|at| size(at) > size(at.saturating_sub(before))).collect()
}

/// Whether at least half of `rows` were met; `None` without rows.
fn mostly_met(rows: impl Iterator<Item = usize>, met: &[bool]) -> Option<bool> {
    let (of_met, all) =
        rows.fold((0, 0), |(of_met, all), row| (of_met + usize::from(met[row]), all + 1));
    (all > 0).then_some(2 * of_met >= all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_push_loads_until_its_deepest_point_and_frames_without_contact_are_neither_met_nor_unmet() {
        let torques: Vec<Vec<f64>> = [0, 1, 2, 3, 2, 1, 0].map(|t| vec![0.0, f64::from(-t)]).into();
        let loads = loading(&torques.iter().collect::<Vec<_>>(), 1);
        assert_eq!(loads, [false, true, true, true, false, false, false]);
        let met = [true, false, false];
        assert_eq!(mostly_met([0, 1].into_iter(), &met), Some(true));
        assert_eq!(mostly_met([0, 1, 2].into_iter(), &met), Some(false));
        assert_eq!(mostly_met([].into_iter(), &met), None);
    }

    #[test]
    fn settings_are_chosen_on_the_other_objects_alone() {
        let relative = [[0.9, 0.5], [0.6, 0.8], [0.5, 0.6]].map(|scores| scores.map(Some).to_vec());
        // Without the first: 0.55 and 0.7. Without the second: 0.7 and 0.55. Without the third: 0.75 and 0.65.
        assert_eq!(chosen_on_others(&relative), [Some(0), Some(1), Some(1)]);
        assert_eq!(chosen_on_others(&relative[..1]), [None]);
        assert_eq!(chosen_on_others(&[]), []);
    }
}
