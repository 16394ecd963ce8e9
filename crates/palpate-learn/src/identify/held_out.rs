//! Residual torques of a model on held-out motion: whole touches, or quarters of them if there are fewer than three.
//! Offset and drift of a touch are not known beforehand, so the residual contains them.

use palpate::unstable::{NoiseFactors, TouchMotion, model_residuals};
use palpate::{
    Causal, Differentiation, ExternalTorque, ExternalTorqueConfig, FalseAlarmModel, Ripple, Robot,
    Sample, TorqueModel, TorqueNoise,
};
use rayon::prelude::*;
use serde::Serialize;

use super::outliers::ResidualOutliers;
use super::posterior::Posterior;
use super::prior::Start;
use super::ripple::RippleSample;
use super::rows::{FOLDS, RegressionSettings, Rows, fold};
use super::{IdentifyError, result, ripple};

/// Root mean squares of the residuals of the measured torques, N·m, by joint.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeldOutResiduals {
    /// After gravity of the URDF.
    pub gravity: Vec<f64>,
    /// After the inverse dynamics of the URDF.
    pub urdf: Vec<f64>,
    /// After the identified model.
    pub identified: Vec<f64>,
    /// `[gravity, urdf, identified]` of residuals averaged over the time window of the speeds.
    pub slow: [Vec<f64>; 3],
    /// Outliers, if few samples have most of the residual of the identified model.
    pub few: Option<ResidualOutliers>,
}

/// The parts of the model that follow from residuals on held-out motion.
pub(super) struct Found {
    pub(super) held_out: HeldOutResiduals,
    pub(super) noise: Vec<TorqueNoise>,
    /// By joint.
    pub(super) ripple: Vec<Vec<Ripple>>,
    pub(super) alarm: Option<FalseAlarmModel>,
    pub(super) causal: Option<Causal>,
}

/// A held-out sample with its residuals, N·m by joint.
pub(super) struct HeldOutSample {
    time_s: f64,
    /// Index of the sample in its touch.
    pub(super) row: usize,
    fold: usize,
    pub(super) gravity: Vec<f64>,
    pub(super) identified: Vec<f64>,
    factors: Vec<NoiseFactors>,
}

/// Selects one of the residuals of a held-out sample.
pub(super) type ResidualOf = fn(&HeldOutSample) -> &Vec<f64>;

/// Half windows that are tried for causal differentiation (on a running robot), s.
const CAUSAL_WINDOWS_S: [f64; 5] = [0.05, 0.1, 0.15, 0.25, 0.4];

pub(super) fn of(
    robot: &Robot,
    (touches, logged): (&[&[Sample]], &[&[Sample]]),
    torques: &ExternalTorqueConfig,
    (rows, settings): (&Rows, &RegressionSettings),
    start: &Start,
    unless_stopped: &dyn Fn() -> Result<(), IdentifyError>,
) -> Result<Found, IdentifyError> {
    let of_all = rows.all();
    let model = |fold: usize| {
        let sums = rows.without(fold);
        let any = sums.iter().zip(&of_all).any(|(sum, all)| sum.rows > 0.0 && sum.rows < all.rows);
        let posterior = if any { Posterior::of(rows, &sums, start) } else { None };
        posterior.map(|posterior| result::model(robot, settings, &posterior))
    };
    (0..FOLDS).try_for_each(|_| unless_stopped())?; // a step of the progress for each
    let models: Vec<Option<TorqueModel>> = (0..FOLDS).into_par_iter().map(model).collect();
    let read = |models: &[Option<TorqueModel>], differentiation: Differentiation| {
        let touches = of_differentiation((touches, logged), differentiation);
        let left = |own| left_of(robot, (touches, own), torques, models, differentiation);
        settings.touched.iter().enumerate().map(left).collect::<Result<Vec<_>, _>>()
    };
    let n = robot.n_joints();
    let noise = |left: &[Vec<HeldOutSample>]| (0..n).map(|j| noise_of(left, j)).collect();
    let mut left = read(&models, Differentiation::Centred)?;
    // For each fold, ripple learned from the other folds; the last entry from all.
    let samples: Vec<RippleSample> = left.iter().flatten().map(HeldOutSample::for_ripple).collect();
    unless_stopped()?;
    let ripples = ripple::find(&samples);
    take_off(&mut left, &ripples);
    let own_noise: Vec<TorqueNoise> = noise(&left);
    let alarm = rows.timed.then(|| alarm_of(&left, &own_noise)).flatten();

    let mut causal: Option<(f64, Causal)> = None;
    for window_s in CAUSAL_WINDOWS_S.into_iter().filter(|window_s| rows.is_timed(*window_s)) {
        unless_stopped()?;
        let other = |model: &Option<TorqueModel>| {
            model.as_ref().map(|model| TorqueModel { window_s, ..model.clone() })
        };
        let mut left =
            read(&models.iter().map(other).collect::<Vec<_>>(), Differentiation::Causal)?;
        take_off(&mut left, &ripples);
        let part =
            |j: usize| root_mean_square(&left, |left| left.identified[j], 0.0) / start.efforts[j];
        let residual = (0..n).map(|j| part(j).powi(2)).sum::<f64>();
        if causal.as_ref().is_none_or(|(least, _)| residual < *least) {
            let noise = noise(&left);
            let alarm = alarm_of(&left, &noise);
            causal = Some((residual, Causal { window_s, noise, alarm }));
        }
    }

    let urdf = TorqueModel { window_s: settings.window_s, ..TorqueModel::of_urdf(robot) };
    let of_urdf = read(&vec![Some(urdf); FOLDS], Differentiation::Centred)?;
    let each: [(&[Vec<HeldOutSample>], ResidualOf); 3] = [
        (&left, |left| &left.gravity),
        (&of_urdf, |left| &left.identified),
        (&left, |left| &left.identified),
    ];
    let rms = |half_s: f64| {
        each.map(|(left, of)| {
            (0..n).map(|j| root_mean_square(left, |left| of(left)[j], half_s)).collect()
        })
    };
    let [gravity, urdf, identified] = rms(0.0);
    let slow = rms(settings.window_s);
    let held_out =
        HeldOutResiduals { gravity, urdf, identified, slow, few: ResidualOutliers::of(&left) };
    let [.., ripple] = ripples;
    let causal = causal.map(|(_, causal)| causal);
    Ok(Found { held_out, noise: own_noise, ripple, alarm, causal })
}

/// Touches with corrected times, or as logged: on a running robot, only the stamps are known.
fn of_differentiation<'a>(
    (touches, logged): (&'a [&'a [Sample]], &'a [&'a [Sample]]),
    differentiation: Differentiation,
) -> &'a [&'a [Sample]] {
    match differentiation {
        Differentiation::Centred => touches,
        Differentiation::Causal => logged,
    }
}

impl HeldOutSample {
    fn for_ripple(&self) -> RippleSample {
        let of = |of: fn(&NoiseFactors) -> f64| self.factors.iter().map(of).collect();
        RippleSample {
            fold: self.fold,
            q: of(|factors| factors.q),
            speed: of(|factors| factors.speed),
            torque: self.identified.clone(),
        }
    }
}

/// Subtracts ripple from the residual.
fn take_off(left: &mut [Vec<HeldOutSample>], ripples: &[Vec<Vec<Ripple>>; FOLDS + 1]) {
    for left in left.iter_mut().flatten() {
        let mut sample = left.for_ripple();
        sample.take_off(&ripples[left.fold]);
        left.identified = sample.torque;
    }
}

/// Residual of each sample of a touch that is not left out, under the model of its fold.
fn left_of(
    robot: &Robot,
    (touches, (touch, touched)): (&[&[Sample]], (usize, &Vec<bool>)),
    torques: &ExternalTorqueConfig,
    models: &[Option<TorqueModel>],
    differentiation: Differentiation,
) -> Result<Vec<HeldOutSample>, IdentifyError> {
    let samples = touches[touch];
    let times = TouchMotion::of(robot, samples, vec![0.0; robot.n_joints()]);
    let time = |k: usize| times.times_s()[k];
    let span = time(samples.len() - 1) - time(0);
    let fold_of = |k: usize| {
        let part = if span > 0.0 { (time(k) - time(0)) / span - 0.5 } else { 0.0 };
        fold(touches.len(), touch, part)
    };
    let mut left = Vec::with_capacity(samples.len());
    for (number, model) in models.iter().enumerate() {
        let Some(model) = model else { continue };
        let which = |k: usize| fold_of(k) == number && !touched[k];
        for (k, found) in
            model_residuals(robot, model, torques, (samples, &which), differentiation)?
        {
            let sample = &samples[k];
            let poses = robot.forward(&sample.q).map_err(palpate::TrackerError::from)?;
            left.push(HeldOutSample {
                time_s: time(k),
                row: k,
                fold: number,
                gravity: torques.untared(robot, &poses, &sample.tau)?.as_slice().to_vec(),
                identified: found.external.as_slice().to_vec(),
                factors: found.factors,
            });
        }
    }
    left.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    Ok(left)
}

/// Root mean square of residuals that are averaged over windows of `2 · half_s` around each sample.
fn root_mean_square(
    left: &[Vec<HeldOutSample>],
    of: impl Fn(&HeldOutSample) -> f64,
    half_s: f64,
) -> f64 {
    let (mut squares, mut count) = (0.0, 0.0);
    for touch in left {
        let (mut from, mut to, mut sum) = (0, 0, 0.0);
        for middle in touch {
            while to < touch.len() && touch[to].time_s <= middle.time_s + half_s {
                sum += of(&touch[to]);
                to += 1;
            }
            while touch[from].time_s < middle.time_s - half_s {
                sum -= of(&touch[from]);
                from += 1;
            }
            squares += (sum / (to - from) as f64).powi(2);
            count += 1.0;
        }
    }
    if count > 0.0 { f64::sqrt(squares / count) } else { 0.0 }
}

/// Noise of a joint: its variance is a non-negative sum of parts, fitted by maximum likelihood for Gaussian noise, as
/// iteratively reweighted least squares on the squared residuals.
fn noise_of(left: &[Vec<HeldOutSample>], j: usize) -> TorqueNoise {
    let parts = |left: &HeldOutSample| {
        let factors = &left.factors[j];
        [1.0, factors.turning.powi(2), factors.speed.powi(2), factors.inertia.powi(2)]
    };
    let square = |left: &HeldOutSample| left.identified[j].powi(2);
    let at_end = |left: &HeldOutSample| left.factors[j].at_end.powi(2);
    let samples: Vec<([f64; 4], f64, f64)> =
        left.iter().flatten().map(|left| (parts(left), square(left), at_end(left))).collect();
    if samples.is_empty() {
        return TorqueNoise { still: 1.0, turning: 0.0, by_speed: 0.0, by_inertia: 0.0 };
    }
    let count = samples.len() as f64;
    let mean = (samples.iter().map(|(_, square, _)| square).sum::<f64>() / count).max(1e-12);
    let mut found = [mean, 0.0, 0.0, 0.0];
    for _ in 0..20 {
        let mut gram = [[0.0; 4]; 4];
        let mut right = [0.0; 4];
        for (parts, square, at_end) in &samples {
            let variance: f64 = parts.iter().zip(found).map(|(part, own)| part * own).sum();
            let weight = (variance.max(0.01 * mean) + at_end).powi(-2);
            for a in 0..4 {
                right[a] += weight * parts[a] * (square - at_end);
                for b in 0..4 {
                    gram[a][b] += weight * parts[a] * parts[b];
                }
            }
        }
        // One coefficient after the other, none below zero.
        for _ in 0..200 {
            for a in 0..4 {
                let others: f64 = (0..4).filter(|b| *b != a).map(|b| gram[a][b] * found[b]).sum();
                if gram[a][a] > 0.0 {
                    found[a] = ((right[a] - others) / gram[a][a]).max(0.0);
                }
            }
        }
        found[0] = found[0].max(0.01 * mean);
    }
    let [still, turning, by_speed, by_inertia] = found.map(f64::sqrt);
    TorqueNoise { still, turning, by_speed, by_inertia }
}

/// The alarm, from the largest |torque| over its standard deviation in each second of held-out motion.
fn alarm_of(left: &[Vec<HeldOutSample>], noise: &[TorqueNoise]) -> Option<FalseAlarmModel> {
    let statistic = |left: &HeldOutSample| {
        let std = noise.iter().zip(&left.factors).map(|(noise, factors)| factors.std(noise));
        let torque = ExternalTorque {
            torque: left.identified.clone().into(),
            std: std.collect::<Vec<_>>().into(),
        };
        (left.time_s, torque.statistic())
    };
    let touches: Vec<Vec<(f64, f64)>> =
        left.iter().map(|touch| touch.iter().map(statistic).collect()).collect();
    FalseAlarmModel::of(&touches)
}
