//! Comparison of settings over several objects: which settings also hold for objects on which they were not chosen.
//!
//! Each touch of an object is predicted from its others under each of the settings, and under those that `map` chooses on
//! its others. Contacts are simulated once for all settings that share a contact model. If every n-th frame is kept, the
//! torque noise is divided by √n, so that evidence and prior keep their balance.

use std::sync::Arc;

use nalgebra::Vector3;
use palpate::{Arm, MapperConfig};
use rayon::prelude::*;
use serde::Serialize;

use crate::choose::MIN_TUNING_TOUCHES;
use crate::error::{LearnError, Stop};
use crate::evaluation::MeanStd;
use crate::folds::{Fold, folds};
use crate::method::Method;
use crate::torque_errors::ErrorSum;
use crate::tracked::{TouchSamples, TrackedFrame, TrackedTouches};
use crate::tune::{FixedSettings, Search, Tuner};

/// A frame counts as loading if its torque is larger than that many frames before (frames before thinning).
const BEFORE: usize = 5;

/// A push is in a known direction if it is within this angle of those that were learnt, degrees.
pub const NEAR_DEGREES: f64 = 30.0;

/// What is studied.
#[derive(Debug, Clone, Copy)]
pub struct StudyPlan {
    /// Every n-th frame is used; this is n.
    pub every: usize,
    /// Whether each touch is also predicted from the 1, 2, 4, … touches after it, under the first settings.
    pub curve: bool,
    /// Whether each touch is also predicted under settings chosen on the others ([`Search::quick`]), starting from the
    /// first settings; these are not changed.
    pub choose: Option<FixedSettings>,
}

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
    /// Average relative error over frames that push the same cells as learnt touches, within [`NEAR_DEGREES`] of the
    /// direction of these.
    pub same_direction: Option<f64>,
    /// Average relative error over frames that push these cells in other directions.
    pub other_direction: Option<f64>,
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
    /// Under the settings that were chosen on the other touches, by touch; empty with fewer than four touches, or if none
    /// were to be chosen.
    pub chosen: Vec<TouchScore>,
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

/// Predicts each touch of an object from its others, under each of `settings`. `done` is called for each candidate of a
/// choice and for each predicted touch, from any thread, for a progress bar.
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
    plan: StudyPlan,
    (stop, done): (Stop<'_>, &(dyn Fn() + Sync)),
) -> Result<ObjectScores, LearnError> {
    assert!(!touches.is_empty(), "there are touches");
    let every = plan.every;
    let given = &settings[0];
    let base = TrackedTouches::new(arm, given, touches, stop)?;
    let one_by_one = folds(touches.len(), touches.len());
    let each = settings.iter().flat_map(|config| one_by_one.iter().map(move |fold| (config, fold)));
    let chosen = chosen((arm, touches), (given, plan.choose), &one_by_one, (stop, done))?;
    let parts: Vec<(&MapperConfig, &Fold)> = each.chain(chosen.iter().zip(&one_by_one)).collect();
    let mut scores: Vec<Option<TouchScore>> = vec![None; parts.len()];
    let mut by_touches_learnt = Vec::new();
    while let Some(first) = scores.iter().position(Option::is_none) {
        let contact = &parts[first].0.contact;
        let tracked = match *contact == given.contact {
            true => base.thinned(every),
            false => base.with_contact_model(contact, arm, given, (touches, every), stop)?,
        };
        let alike = scores.par_iter_mut().zip(&parts);
        alike.filter(|(_, (config, _))| config.contact == *contact).try_for_each(
            |(own, (config, fold))| {
                *own = Some(score(&tracked, fold, (config, every), stop)?);
                done();
                Ok::<_, LearnError>(())
            },
        )?;
        if first == 0 && plan.curve {
            by_touches_learnt = learning_curve(&tracked, (given, every), stop)?;
        }
    }
    let scores: Vec<TouchScore> = scores.into_iter().flatten().collect();
    let (of_settings, chosen) = scores.split_at(settings.len() * touches.len());
    let settings = of_settings.chunks(touches.len()).map(<[TouchScore]>::to_vec).collect();
    Ok(ObjectScores { settings, chosen: chosen.to_vec(), by_touches_learnt })
}

/// By fold, the settings that are chosen on its training touches; none if there are too few of these.
fn chosen(
    (arm, touches): (&Arc<Arm>, &[TouchSamples]),
    (given, choose): (&MapperConfig, Option<FixedSettings>),
    folds: &[Fold],
    (stop, done): (Stop<'_>, &(dyn Fn() + Sync)),
) -> Result<Vec<MapperConfig>, LearnError> {
    let Some(fixed) = choose.filter(|_| touches.len() > MIN_TUNING_TOUCHES) else {
        return Ok(Vec::new());
    };
    let search = Search::quick(given, fixed);
    let base = TrackedTouches::sparse(arm, given, touches, stop)?;
    let tuner = Tuner::new((arm, touches, &base), given, search, stop, done)?;
    folds.iter().map(|fold| Ok(tuner.tune(&fold.train, stop)?.config)).collect()
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
    let pushed = pushed(tracked, &fold.train);
    let is_near = |frame: &TrackedFrame| {
        let learnt: Vector3<f64> = frame.observation.rows().map(|row| pushed[row]).sum();
        is_near(&*frame.push?, &learnt)
    };
    let is_near: Vec<Option<bool>> = touch.frames.iter().map(is_near).collect();
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
        same_direction: relative(&|at| is_near[at] == Some(true)),
        other_direction: relative(&|at| is_near[at] == Some(false)),
        joint_error_n_m: by_joint(&|predicted, target| predicted - target),
        joint_torque_n_m: by_joint(&|_, target| target),
    })
}

/// By frame, whether the norm of its torque is larger than that `before` frames earlier.
fn loading(torques: &[&Vec<f64>], before: usize) -> Vec<bool> {
    let size = |at: usize| torques[at].iter().map(|t| t * t).sum::<f64>();
    (0..torques.len()).map(|at| size(at) > size(at.saturating_sub(before))).collect()
}

/// By row, the sum of the directions in which these touches pushed the cell.
fn pushed(tracked: &TrackedTouches, touches: &[usize]) -> Vec<Vector3<f64>> {
    let mut pushed = vec![Vector3::zeros(); tracked.cells.len()];
    for frame in touches.iter().flat_map(|&touch| &tracked.touches[touch].frames) {
        if let Some(push) = &frame.push {
            frame.observation.rows().for_each(|row| pushed[row] += **push);
        }
    }
    pushed
}

/// Whether a push is within [`NEAR_DEGREES`] of `learnt`; `None` if nothing was learnt.
fn is_near(push: &Vector3<f64>, learnt: &Vector3<f64>) -> Option<bool> {
    (learnt.norm() > 0.0).then(|| push.angle(learnt) <= NEAR_DEGREES.to_radians())
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
    fn a_push_is_near_those_of_which_most_go_its_way() {
        let degrees =
            |angle: f64| Vector3::new(angle.to_radians().cos(), angle.to_radians().sin(), 0.0);
        assert_eq!(is_near(&degrees(0.0), &(degrees(50.0) + degrees(-10.0))), Some(true));
        assert_eq!(is_near(&degrees(0.0), &(degrees(50.0) + degrees(20.0))), Some(false));
        assert_eq!(is_near(&degrees(0.0), &(degrees(90.0) * 3.0)), Some(false));
        assert_eq!(is_near(&degrees(0.0), &Vector3::zeros()), None);
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
