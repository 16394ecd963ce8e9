//! What a model leaves over of torques on motion that it was not identified on: whole touches, or quarters of them if
//! there are fewer than three. Bias and drift of a touch are not known beforehand, so they are in it.

use palpate::unstable::{NoiseFactors, Side, explain};
use palpate::{
    Alarm, Detector, ExternalTorque, ExternalTorqueConfig, Robot, Sample, TorqueModel, TorqueNoise,
};
use serde::Serialize;

use super::posterior::{Posterior, Start};
use super::rows::{FOLDS, Rows, Settings, fold};
use super::{IdentifyError, result};

/// Root mean squares of what is left over of the measured torques, N·m, by joint.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HeldOut {
    /// After gravity as the URDF says it.
    pub gravity: Vec<f64>,
    /// After the inverse dynamics of the URDF.
    pub urdf: Vec<f64>,
    /// After the identified model.
    pub identified: Vec<f64>,
    /// The three again, of means over the time window that speeds are computed in.
    pub slow: [Vec<f64>; 3],
}

/// What follows for the model.
pub(super) struct Found {
    pub(super) held_out: HeldOut,
    pub(super) noise: Vec<TorqueNoise>,
    pub(super) alarm: Option<Alarm>,
}

/// One sample that was held out.
struct Left {
    time_s: f64,
    gravity: Vec<f64>,
    urdf: Vec<f64>,
    identified: Vec<f64>,
    factors: Vec<NoiseFactors>,
}

pub(super) fn of(
    robot: &Robot,
    touches: &[&[Sample]],
    torques: &ExternalTorqueConfig,
    (rows, settings): (&Rows, &Settings),
    start: &Start,
) -> Result<Found, IdentifyError> {
    let urdf = TorqueModel { window_s: settings.window_s, ..TorqueModel::of_urdf(robot) };
    let mut models: Vec<Option<TorqueModel>> = Vec::with_capacity(FOLDS);
    for fold in 0..FOLDS {
        let sums = rows.without(fold);
        let any =
            sums.iter().zip(rows.all()).any(|(sum, all)| sum.rows > 0.0 && sum.rows < all.rows);
        let posterior = if any { Posterior::of(rows, &sums, start) } else { None };
        models.push(posterior.map(|posterior| result::model(robot, settings, &posterior)));
    }
    let mut left: Vec<Vec<Left>> = Vec::new();
    for (touch, samples) in touches.iter().enumerate() {
        let by_urdf = explain(robot, &urdf, torques, samples, Side::Around)?;
        let by_fold = models.iter().map(|model| {
            let model = model.as_ref()?;
            Some(explain(robot, model, torques, samples, Side::Around))
        });
        let by_fold: Vec<_> = by_fold.map(Option::transpose).collect::<Result<_, _>>()?;
        let n = samples.len();
        let mut own = Vec::with_capacity(n);
        for (k, sample) in samples.iter().enumerate() {
            let time = |k: usize| samples[k].time_s.unwrap_or(k as f64);
            let span = time(n - 1) - time(0);
            let part = if span > 0.0 { (time(k) - time(0)) / span - 0.5 } else { 0.0 };
            let Some(found) = &by_fold[fold(touches.len(), touch, part)] else { continue };
            let poses = robot.forward(&sample.q).map_err(palpate::TrackerError::from)?;
            own.push(Left {
                time_s: time(k),
                gravity: torques.untared(robot, &poses, &sample.tau)?.as_slice().to_vec(),
                urdf: by_urdf[k].external.as_slice().to_vec(),
                identified: found[k].external.as_slice().to_vec(),
                factors: found[k].factors.clone(),
            });
        }
        left.push(own);
    }
    let n = robot.n_joints();
    let rms = |of: fn(&Left) -> &Vec<f64>, half_s: f64| -> Vec<f64> {
        (0..n).map(|j| root_mean_square(&left, |left| of(left)[j], half_s)).collect()
    };
    let each: [fn(&Left) -> &Vec<f64>; 3] =
        [|left| &left.gravity, |left| &left.urdf, |left| &left.identified];
    let [gravity, of_urdf, identified] = each.map(|of| rms(of, 0.0));
    let slow = each.map(|of| rms(of, settings.window_s));
    let noise: Vec<TorqueNoise> = (0..n).map(|j| noise_of(&left, j)).collect();
    let alarm = rows.timed.then(|| alarm_of(&left, &noise)).flatten();
    Ok(Found { held_out: HeldOut { gravity, urdf: of_urdf, identified, slow }, noise, alarm })
}

/// Of means over windows of `2 · half_s` around each sample.
fn root_mean_square(left: &[Vec<Left>], of: impl Fn(&Left) -> f64, half_s: f64) -> f64 {
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

/// Variance as a sum of parts that are at least zero, the most probable one of Gaussian noise: least squares of the
/// squares, weighted with the variance itself.
fn noise_of(left: &[Vec<Left>], j: usize) -> TorqueNoise {
    let parts = |left: &Left| {
        let factors = &left.factors[j];
        [1.0, factors.between.powi(2), factors.speed.powi(2), factors.inertia.powi(2)]
    };
    let samples: Vec<([f64; 4], f64)> =
        left.iter().flatten().map(|left| (parts(left), left.identified[j].powi(2))).collect();
    if samples.is_empty() {
        return TorqueNoise { still: 1.0, turning: 0.0, by_speed: 0.0, by_inertia: 0.0 };
    }
    let count = samples.len() as f64;
    let mean = (samples.iter().map(|(_, square)| square).sum::<f64>() / count).max(1e-12);
    let mut found = [mean, 0.0, 0.0, 0.0];
    for _ in 0..20 {
        let mut gram = [[0.0; 4]; 4];
        let mut right = [0.0; 4];
        for (parts, square) in &samples {
            let variance: f64 = parts.iter().zip(found).map(|(part, own)| part * own).sum();
            let weight = (variance.max(0.01 * mean)).powi(-2);
            for a in 0..4 {
                right[a] += weight * parts[a] * square;
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

/// Of the largest |torque| over its standard deviation, in each second.
fn alarm_of(left: &[Vec<Left>], noise: &[TorqueNoise]) -> Option<Alarm> {
    let statistic = |left: &Left| {
        let std = noise
            .iter()
            .zip(&left.factors)
            .map(|(noise, factors)| noise.std(factors.between, factors.speed, factors.inertia));
        let torque = ExternalTorque {
            torque: left.identified.clone().into(),
            std: std.collect::<Vec<_>>().into(),
        };
        (left.time_s, Detector::statistic(&torque))
    };
    let touches: Vec<Vec<(f64, f64)>> =
        left.iter().map(|touch| touch.iter().map(statistic).collect()).collect();
    Alarm::of(&touches)
}
