//! Samples in which something is touched: the residual of the model of free motion is far larger than usual.
//!
//! Whoever guides or meets the arm in a quarter of a log would otherwise be explained as friction and gains, and hide in
//! that. So samples that are far off are left out step by step, as in least trimmed squares (Rousseeuw and Van Driessen
//! 2006). The friction of a real arm is far off as well now and then, up to 20 times its usual size; to leave that out
//! would flatter the model. So nothing is left out unless motion that was held out, without these samples, is predicted
//! clearly better by a model that does not know them: contacts spoil it, friction does not.

use rayon::prelude::*;

use super::IdentifyError;
use super::posterior::Posterior;
use super::rows::{FOLDS, Rows};
use super::search::{Fit, Search};
use crate::upper_median::upper_median;

/// Half of the time that residuals are averaged over, s.
const HALF_WINDOW_S: f64 = 0.1;
/// Mean residuals, relative to their usual size, that are suspect, and up to where their surroundings are.
const SUSPECT: f64 = 5.0;
const END: f64 = 3.0;
/// The part of the samples that is left out at first, and that may be left out at most: of more it is not known which is the
/// motion that is free.
const FIRST: f64 = 0.4;
const MOST: f64 = 0.5;
/// Residual of motion that was held out, relative to that of all samples, if leaving out is to pay.
const BETTER: f64 = 0.9;
/// Steps in which the farthest samples are left out, then only those that are suspect; and searches without these.
const FIRST_STEPS: usize = 3;
const STEPS: usize = 9;
const SEARCHES: usize = 3;
/// Median of |x| for a Gaussian x with standard deviation 1.
pub(super) const MEDIAN: f64 = 0.674_5;

/// Whether a sample is left out, by touch.
pub(super) type Touched = Vec<Vec<bool>>;

/// The fit again without samples in which something is touched, if there are any.
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

/// Samples that are suspect: of a model that was found without them, at first without those that are farthest off. The rows
/// are then without them, too.
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

/// Root of the sum of squared residuals of motion that was held out but for some samples, over all joints; in N·m as
/// gains say it.
fn held_out_residual(fit: &Fit, search: &Search<'_>, but: &Touched) -> f64 {
    let Fit { rows, posterior, .. } = fit;
    let model = |fold: usize| Posterior::of_independent(rows, &rows.without(fold), search.start);
    let models: Vec<Option<Posterior>> = (0..FOLDS).into_par_iter().map(model).collect();
    let of_joint = |j: usize| rows.held_out(&models, j, but) / posterior.gain(j).powi(2);
    (0..rows.n_joints()).map(of_joint).sum::<f64>().sqrt()
}

/// How far off each row is: the mean residual around it, relative to its usual size, in the joint where that is
/// largest.
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

/// The samples that are farthest off.
fn farthest(rows: &Rows, distances: &[f64]) -> Touched {
    let mut order: Vec<usize> = (0..distances.len()).collect();
    order.sort_by(|a, b| distances[*b].total_cmp(&distances[*a]));
    order.truncate((FIRST * distances.len() as f64) as usize);
    samples_of(rows, order.into_iter())
}

/// Samples that are suspect, with their surroundings; the farthest if there are too many.
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

/// Whether it is the same but for a hundredth of the samples.
fn is_near(touched: &Touched, other: &Touched) -> bool {
    let each = || touched.iter().flatten().zip(other.iter().flatten());
    100 * each().filter(|(a, b)| a != b).count() <= each().count()
}

/// The part of all samples, 0 to 1.
pub(super) fn part(touched: &Touched) -> f64 {
    let samples = || touched.iter().flatten();
    samples().filter(|touched| **touched).count() as f64 / samples().count().max(1) as f64
}
