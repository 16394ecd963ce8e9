//! Samples in which something is touched: the residual of the model of free motion is far larger than usual.
//!
//! A person who guides the arm during a quarter of a log would otherwise be fitted by friction and gains, and the
//! residual would not show it. So outliers are left out step by step, as in least trimmed squares (Rousseeuw and Van
//! Driessen 2006). Friction of a real arm causes outliers too, up to 20 times the usual residual, and leaving these out
//! would make the model look better than it is. So samples are left out only if the other held-out motion is predicted
//! clearly better by a model that was learned without them: this is so for contacts, but not for friction.

use rayon::prelude::*;

use super::IdentifyError;
use super::posterior::Posterior;
use super::rows::{FOLDS, Rows};
use super::search::{Fit, Search};
use crate::upper_median::upper_median;

/// Half of the time that residuals are averaged over, s.
const HALF_WINDOW_S: f64 = 0.1;
/// Mean residual, in robust standard deviations, above which a sample is suspect.
const SUSPECT: f64 = 5.0;
/// Neighbours of a suspect sample are suspect too while their mean residual is above this.
const END: f64 = 3.0;
/// The fraction of the samples that is left out in the first steps, or whenever more than [`MOST`] are suspect.
const FIRST: f64 = 0.4;
/// Largest fraction of suspect samples: with more, it is unclear which part is the free motion.
const MOST: f64 = 0.5;
/// Samples are left out only if this reduces the residual on held-out motion to this fraction or less.
const BETTER: f64 = 0.9;
/// Steps in which the samples with the largest residuals are left out; after these, only suspect samples are.
const FIRST_STEPS: usize = 3;
/// Most steps in all.
const STEPS: usize = 9;
/// Most repetitions of the whole search without the suspect samples.
const SEARCHES: usize = 3;
/// Median of |x| for a Gaussian x with standard deviation 1.
pub(super) const MEDIAN: f64 = 0.674_5;

/// Whether each sample is left out, by touch.
pub(super) type Touched = Vec<Vec<bool>>;

/// Repeats the fit without the samples in which something is touched, if there are any.
pub(super) fn leave_out(
    search: &Search<'_>,
    mut all: Fit,
    unless_stopped: &dyn Fn() -> Result<(), IdentifyError>,
) -> Result<Fit, IdentifyError> {
    unless_stopped()?;
    let none = all.settings.touched.clone();
    let found = suspects(&mut all, search, FIRST_STEPS)?;
    let without = held_out_residual(&all, search, &found);
    all.rows.leave_out(&none);
    if part(&found) == 0.0 || without > BETTER * held_out_residual(&all, search, &found) {
        return Ok(all);
    }
    let mut fit = search.run(found, unless_stopped)?;
    for _ in 1..SEARCHES {
        let found = suspects(&mut fit, search, 0)?;
        if is_near(&found, &fit.settings.touched) {
            fit.rows.leave_out(&fit.settings.touched);
            break;
        }
        fit = search.run(found, unless_stopped)?;
    }
    Ok(fit)
}

/// The suspect samples under a model that is fitted without them; in the first steps it is fitted without the samples
/// with the largest residuals. The rows of `fit` leave out the same samples afterwards.
fn suspects(
    fit: &mut Fit,
    search: &Search<'_>,
    first_steps: usize,
) -> Result<Touched, IdentifyError> {
    let mut distances = distances(&fit.rows, &fit.posterior);
    let mut found = fit.settings.touched.clone();
    for step in 0..STEPS {
        let pick = if step < first_steps { farthest } else { far_off };
        let before = std::mem::replace(&mut found, pick(&fit.rows, &distances));
        fit.rows.leave_out(&found);
        if step >= first_steps && (is_near(&found, &before) || part(&found) == 0.0) {
            break;
        }
        let posterior = Posterior::of_independent(&fit.rows, &fit.rows.all(), search.start);
        distances = self::distances(&fit.rows, &posterior.ok_or(IdentifyError::Unsolvable)?);
    }
    Ok(found)
}

/// Root of the sum of squared residuals on held-out motion without the samples in `but`, over all joints; each joint is
/// divided by its gain, so that it is in N·m.
fn held_out_residual(fit: &Fit, search: &Search<'_>, but: &Touched) -> f64 {
    let Fit { rows, posterior, .. } = fit;
    let model = |fold: usize| Posterior::of_independent(rows, &rows.without(fold), search.start);
    let models: Vec<Option<Posterior>> = (0..FOLDS).into_par_iter().map(model).collect();
    let of_joint = |j: usize| rows.held_out(&models, j, but) / posterior.gain(j).powi(2);
    (0..rows.n_joints()).map(of_joint).sum::<f64>().sqrt()
}

/// For each row, the mean residual around it in robust standard deviations, largest over the joints.
fn distances(rows: &Rows, posterior: &Posterior) -> Vec<f64> {
    let mut largest = vec![0.0_f64; rows.len()];
    for j in 0..rows.n_joints() {
        let means = rows.mean_residuals(posterior, j, HALF_WINDOW_S);
        let mut sizes: Vec<f64> = means.iter().flatten().map(|mean| mean.abs()).collect();
        let Some(median) = upper_median(&mut sizes) else { continue };
        let usual = median / MEDIAN;
        for (largest, mean) in largest.iter_mut().zip(means) {
            *largest = largest.max(mean.map_or(0.0, |mean| mean.abs() / usual.max(1e-9)));
        }
    }
    largest
}

/// The [`FIRST`] part of the samples with the largest residuals.
fn farthest(rows: &Rows, distances: &[f64]) -> Touched {
    let mut order: Vec<usize> = (0..distances.len()).collect();
    order.sort_by(|a, b| distances[*b].total_cmp(&distances[*a]));
    order.truncate((FIRST * distances.len() as f64) as usize);
    samples_of(rows, order.into_iter())
}

/// The suspect samples with their neighbours, or [`farthest`] if they are more than [`MOST`].
fn far_off(rows: &Rows, distances: &[f64]) -> Touched {
    let touch = |row: usize| rows.samples(row).0;
    let numbers: Vec<usize> = (0..distances.len()).collect();
    let is_same = |a: &usize, b: &usize| {
        touch(*a) == touch(*b) && (distances[*a] > END) == (distances[*b] > END)
    };
    let runs = numbers.chunk_by(is_same);
    let suspect = runs.filter(|run| run.iter().any(|row| distances[*row] > SUSPECT));
    let found = samples_of(rows, suspect.flatten().copied());
    if part(&found) > MOST { farthest(rows, distances) } else { found }
}

fn samples_of(rows: &Rows, which: impl Iterator<Item = usize>) -> Touched {
    let mut found = rows.no_samples();
    for (touch, samples) in which.map(|row| rows.samples(row)) {
        found[touch][samples].fill(true);
    }
    found
}

/// Whether at most 1 % of the samples differ.
fn is_near(touched: &Touched, other: &Touched) -> bool {
    let each = || touched.iter().flatten().zip(other.iter().flatten());
    100 * each().filter(|(a, b)| a != b).count() <= each().count()
}

/// The fraction of all samples that is left out, 0 to 1.
pub(super) fn part(touched: &Touched) -> f64 {
    let samples = || touched.iter().flatten();
    samples().filter(|touched| **touched).count() as f64 / samples().count().max(1) as f64
}
