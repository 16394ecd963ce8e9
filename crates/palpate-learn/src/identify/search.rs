//! Search for the parameters that are not linear in the regression: window, delay, and friction at reversals.

use palpate::{Robot, Sample, TorqueSign};
use rayon::prelude::*;

use super::IdentifyError;
use super::contact_samples::Touched;
use super::posterior::Posterior;
use super::prior::Start;
use super::rows::{FrictionReversal, RegressionSettings, Rows};

/// Half windows for speeds and accelerations that are tried, s.
const WINDOWS_S: [f64; 6] = [0.05, 0.1, 0.17, 0.25, 0.35, 0.5];
/// Friction at reversals at the start of the search.
const TURNING: FrictionReversal = FrictionReversal { presliding: 1e-3, stribeck: 0.03 };
/// Most steps of the search for delay and presliding distances.
const STEPS: usize = 14;
/// The search has converged if the remaining delay is below this fraction of the sampling interval.
const SETTLED: f64 = 0.02;
/// Largest delay of the search, s, in both directions.
const MAX_DELAY_S: f64 = 0.3;

/// Input of the search.
pub(super) struct Search<'a> {
    pub(super) robot: &'a Robot,
    pub(super) touches: &'a [&'a [Sample]],
    pub(super) sign: TorqueSign,
    pub(super) start: &'a Start,
}

/// Result of the search: the settings with the smallest residual, and their posterior.
pub(super) struct Fit {
    pub(super) settings: RegressionSettings,
    pub(super) rows: Rows,
    pub(super) posterior: Posterior,
    pub(super) has_settled: bool,
}

impl Search<'_> {
    /// Fits all samples except those in `touched`.
    pub(super) fn run(
        &self,
        touched: Touched,
        unless_stopped: &dyn Fn() -> Result<(), IdentifyError>,
    ) -> Result<Fit, IdentifyError> {
        let turning = vec![TURNING; self.robot.n_joints()];
        let mut settings =
            RegressionSettings { window_s: WINDOWS_S[0], delay_s: 0.0, turning, touched };
        // Windows that give speeds are preferred: at a low sampling rate, the shortest ones give none.
        let mut best = ([true; 2], f64::INFINITY);
        let tried = WINDOWS_S.map(|window_s| RegressionSettings { window_s, ..settings.clone() });
        WINDOWS_S.iter().try_for_each(|_| unless_stopped())?; // a step of the progress for each
        let solve = |tried: &RegressionSettings| {
            let (rows, posterior) = self.solve(tried)?;
            let is_sure = rows.is_timed(tried.window_s);
            Ok(([!is_sure, !rows.timed], posterior.residual_variance()))
        };
        let found: Result<Vec<([bool; 2], f64)>, IdentifyError> =
            tried.par_iter().map(solve).collect();
        for (found, tried) in found?.into_iter().zip(tried) {
            if found < best {
                (best, settings) = (found, tried);
            }
        }
        let (mut rows, mut posterior) = self.solve(&settings)?;
        // A long presliding distance looks like a delay, so both are searched together. The delay is found by the
        // secant method, since the regression underestimates the remaining delay.
        let mut last: Option<(f64, f64)> = None;
        let mut has_settled = false;
        for _ in 0..STEPS {
            unless_stopped()?;
            let turning = rows.best_turning(&posterior);
            let left = if rows.timed { posterior.delay().0 } else { 0.0 };
            has_settled = left.abs() <= SETTLED * rows.interval_s()
                && turning.iter().zip(&settings.turning).all(|(new, old)| new.is_near(old));
            if has_settled && turning == settings.turning {
                break;
            }
            settings.turning = turning;
            let step = match last {
                Some((before, left_before)) if (left - left_before).abs() > 1e-9 => {
                    let secant = -left * (settings.delay_s - before) / (left - left_before);
                    secant.clamp(-5.0 * left.abs(), 5.0 * left.abs())
                }
                _ => left,
            };
            last = Some((settings.delay_s, left));
            settings.delay_s = (settings.delay_s + step).clamp(-MAX_DELAY_S, MAX_DELAY_S);
            (rows, posterior) = self.solve(&settings)?;
        }
        Ok(Fit { settings, rows, posterior, has_settled })
    }

    fn solve(&self, settings: &RegressionSettings) -> Result<(Rows, Posterior), IdentifyError> {
        let rows = Rows::of(self.robot, self.touches, self.sign, settings)?;
        let posterior =
            Posterior::of(&rows, &rows.all(), self.start).ok_or(IdentifyError::Unsolvable)?;
        Ok((rows, posterior))
    }
}
